"""Cars of other equations: three simulators written apart from `split_cli`, pairs of their drives, and what is found.

    python -m tests.studies.other_cars FOLDER --seed 700 --pairs 12         # writes the pairs and their truth
    python -m tests.studies.other_cars FOLDER --seed 700 --pairs 12 --run   # diagnoses each, prints the table

Every pair has a car drawn about one of three, two drivers on two courses, none to four effects, and sensor noise in
both drives. FOLDER/cases/NNN holds what a diagnosis may read: ``real.parquet``, ``sim.parquet``, ``vehicle.yaml``.
FOLDER/truth.json holds what was put in. Rows of diagnosed pairs are kept in FOLDER/rows.jsonl, so that a run that was
stopped goes on. Seeds below 1,000 are for development, those from 7001 on for reports; a reported seed is run once.

The simulators (`tyres`, `surroundings`, `sports_car`, `van`, `model_car`, `integration`, `course`, `driver`,
`recording`) import nothing of `split_cli`. They are the author's own equations of textbook physics.

- `sports_car`: rear-driven, four spinning wheels, brush tyres that share their grip, load by roll stiffness.
- `van`: front-driven, TMeasy tyres with relaxed forces, a body that rolls, and roll steer.
- `model_car`: 1:10, all wheels on one shaft, Magic Formula of the combined slip, a servo of second order.

Compiled code is kept between runs. Numba does not see that a file changed which another one calls: after an edit of
`tyres` or `surroundings` delete ``__pycache__`` here.
"""
