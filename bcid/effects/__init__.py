"""The vocabulary of missing physics: in each family's module the equations as compiled functions, and their entries.

Families: `tyres`, `motor`, `steering`, `forces` (on the body), `measurement` (of the pose); `corrections` (flaws of the
base model that are no effects), `remainder` (what has no name), its table of functions (`remainder_table`) and how they
are computed (`harmonics`), with the numbers of `constants` and the `lags` in closed form.  They act in `actuators`
(from commands to the servo's angle and throttle), `linkage` (to the wheel's), `car` (the equations of motion) and
`motion` (their integration), what has no name by `unnamed_action`; `motor_past` is what a lagging motor has from
before.
`entry` is what an effect declares, `table` lists all, `listing` prints them.
A user's file imports `own`; `own_file` reads it and puts its effects into use, `own_checks` and `own_law_checks` say
whether they are such, and `own_laws` is how their laws get into the compiled car.
"""
