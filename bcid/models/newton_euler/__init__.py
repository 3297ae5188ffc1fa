"""Newton-Euler models of the twist: fitted constants, their linearisation, and the car augmented by effects.

`model` (the fitted car), `parameters` (the constants that a fit chooses), fitted by `fit_to_twists` (with `objective`,
the error of many cars at once) or `fit_to_poses`, from the car of `initial_guess`; `linear` (small angles);
`augmented` (the car with effects) and `augmented_step` (its periods, compiled); `with_remainder` (that car and free
functions of its state), `remainder_step` (its periods) and `unnamed_part` (the functions); `saved_car` (what the files
of cars must hold).
"""
