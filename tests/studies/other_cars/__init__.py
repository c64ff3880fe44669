"""Cars of other equations: three simulators written apart from `split_cli`, pairs of their drives, and what is found.

    python -m tests.studies.other_cars FOLDER --seed 700 --pairs 12         # writes the pairs and their truth
    python -m tests.studies.other_cars FOLDER --seed 700 --pairs 12 --run   # diagnoses each, prints the table

Every pair has a car drawn about one of three, two drivers on two courses, none to four effects, and sensor noise in
both drives. FOLDER/cases/NNN holds what a diagnosis may read: ``real.parquet``, ``sim.parquet``, ``vehicle.yaml``.
FOLDER/truth.json holds what was put in. Rows of diagnosed pairs are kept in FOLDER/rows.jsonl, so that a run that was
stopped goes on. Seeds below 1,000 are for development, those from 7001 on for reports; a reported seed is run once.

The simulators (`tyres`, `wheels`, `surroundings`, `sports_car`, `van`, `model_car`, `integration`, `cars`, `course`,
`driver`, `recording`, `effects`, `sizes`) import nothing of `split_cli`. Their equations are the author's own.

- `sports_car`: rear-driven, four spinning wheels, brush tyres that share their grip, load by roll stiffness.
- `van`: front-driven, TMeasy tyres with relaxed forces, a body that rolls, and roll steer.
- `model_car`: 1:10, all wheels on one shaft, Magic Formula of the combined slip, a servo of second order.
"""

from pathlib import Path


def forget_outdated_code(folder: Path) -> None:
    """Delete compiled code in a folder that is older than any of its sources.

    Numba renews the compiled code of a file that changed, but not that of files which call it: a loop would go on
    with the equations of before.
    """
    newest = max(source.stat().st_mtime_ns for source in folder.glob("*.py"))
    for index in (folder / "__pycache__").glob("*.nbi"):
        if index.stat().st_mtime_ns < newest:
            index.unlink(missing_ok=True)


forget_outdated_code(Path(__file__).parent)
