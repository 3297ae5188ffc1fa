"""The vocabulary of missing physics: in each family's module the equations as compiled functions, and their entries.

Families: `tyres`, `motor`, `steering`, `forces` (on the body), `measurement` (of the pose); `corrections` (flaws of the
base model that are no effects), with the numbers of `constants` and the `lags` in closed form.  What has no name is
`remainder`.  They act in `actuators` (from commands to wheel and throttle), `car` (the equations of motion) and
`motion` (their integration).
`entry` is what an effect declares, `table` lists all, `listing` prints them.
"""
