"""Cars to make logs with.  They share no code with the models that explain them (import-linter guards it).

`car` (its constants), `dynamics` (the plant) over `wheels`, `drive_train`, `surroundings` and `other_laws` (of other
formulas than the vocabulary's); `driver` (who keeps the bumper car in the arena), `drive` (a drive as it is recorded),
`open_loop` (one under commands given beforehand);
`small_car` (small cars, drawn), `room_drivers` (who drives them in a room) over `handling` and `room_guard`,
`room_drive` (such a drive); `tricycle` (a plant of its own, driven at its wheel's speed), `tricycle_drive` (its drives
in a hall, forward and backward); `writing` (a drive's files), `samples` (the drives of `sample_logs/`).
"""
