"""The judgement of a search: which effects are named, how probable they are, what remains, what naming them is worth.

`held_out` (gains on blocks that a refit has not seen), `verdict` (findings, probabilities, verdict), `fitted_models`
(fits as models that predict), `free_functions` (beside these, as far as they do good), `prediction_error` (before and
after), `not_excited` (what the drive does not show), `other_figures` (of the simulation that it was given).
"""
