"""The comparison as tables, figures and one offline page.  Plots only draw what the tables hold.

Pages: `page` (the comparison, from its `content`), `diagnosis_page` (a diagnosis), `proof_page` (a blind test),
`fleet_page` (many logs), filled into `templates`.  Pictures of a comparison: `model_figures`.  Pictures of a diagnosis:
`law_figures` (the missing law), `where_figures` and `before_after_figures` (from the `disturbance` left);
`path_stretch` says which path is shown.  All are drawn on a `canvas`.  Words: `verdict_words` (the verdict),
`everyday_words` (sizes of findings), `budget_words` (parts of the error), `so_what` (what it comes to, what to do
next), `drive_words` (what to drive next), `fleet_words` (what many logs say together), `real_answers` (questions to
real recordings), `formats` (numbers and units).  `limits` decides what is shown.
"""
