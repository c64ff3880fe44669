"""Streaming local processes of others beside ours: LoG-GP (Lederer et al. 2021) and SkyGP (Yang et al. 2026).

Their code is no part of this project. Each function takes the folder of a clone, loads the authors' own class from
it, gives it the kernel that the stream's labels were made for, and offers it every sample once, in order.
"""

import contextlib
import importlib.util
import io
import random
from collections.abc import Callable
from pathlib import Path

import click
import numpy as np

from tests.benchmarks.rival_stream import SLOW_QUERIES, Samples, Timed, accuracy, each, percentiles, spent

#: Points a local process holds: the papers' 50 and 100.
POINTS = (50, 100)
#: (Points an expert, nearest experts that answer, experts looked at beside the last one; None for all) of SkyGP.
SKY_SETTINGS = ((50, 4, None), (100, 2, None), (50, 2, 4))


def log_gp_rows(folder: Path, stream: Samples, full: np.ndarray | None) -> list[Timed]:
    """Return a row for each leaf size of LoG-GP; its authors' Python answers with the mean alone."""
    made = _loaded(folder / "LoGGP.py", "LoGGP")
    if made is None:
        return []
    kernel, rows = stream.rivals, []
    for points in POINTS:
        random.seed(0)
        model = made(3, 3, points, 4 * max(1, -(-len(stream.z) // points)), True)
        model.sigmaF, model.sigmaN = np.sqrt(kernel.signal_variance), np.sqrt(kernel.noise_variance)
        model.lengthS = kernel.length_scales.T.copy()
        update = _offered(lambda k, to=model: to.update(stream.z[k], stream.y[k]), len(stream.z))
        query = each(model.predict, list(stream.queries))
        mean = np.stack([model.predict(z) for z in stream.queries])
        # Without a variance there is neither density nor coverage.
        found = accuracy(mean, np.ones_like(mean), stream, full) | {"nlpd": None, "coverage_95": None}
        rows.append(
            Timed(f"LoG-GP, {points} points a leaf, mean only", len(stream.z), None, None, *update, *query, **found)
        )
    return rows


def sky_gp_rows(folder: Path, stream: Samples, full: np.ndarray | None) -> list[Timed]:
    """Return a row for each setting of SkyGP-BCM, one model an output as its update is written for one.

    It is asked about a sample before it is offered it, as its authors use it: the update reuses what the
    prediction has computed. The time of an update is that of `add_point` alone.
    """
    made = _loaded(folder / "models" / "SkyGP_BCM.py", "SkyGP_BCM")
    if made is None:
        return []

    class One(made):
        """Their class, its single label handed on as a number: NumPy 2.4 takes no array of one for it.

        Theirs leaves out experts that learned nothing for 690 predictions. Here no expert is forgotten, since what
        is learned does not change, and since queries follow one another without labels.
        """

        def predict(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            self.expert_weights = [1.0] * len(self.expert_weights)
            return super().predict(x)

        def update_param_incremental(self, x: np.ndarray, y: np.ndarray, model: int) -> None:
            super().update_param_incremental(x, float(np.ravel(y)[0]), model)

    kernel, rows = stream.rivals, []
    for points, nearest, looked_at in SKY_SETTINGS:
        models = [
            One(
                3,
                1,
                max_data_per_expert=points,
                nearest_k=nearest,
                max_experts=looked_at or 10**6,
                timescale=0.03 if looked_at else 1e-3,  # how far a query moves until all are looked at
                pretrained_params=(
                    np.sqrt(kernel.signal_variance[[k]]),
                    np.sqrt(kernel.noise_variance[[k]]),
                    kernel.length_scales[k].copy(),
                ),
            )
            for k in range(3)
        ]

        def predict(z: np.ndarray, models: list = models) -> tuple[np.ndarray, np.ndarray]:
            answers = [model.predict(z) for model in models]
            return np.ravel([a[0] for a in answers]), np.ravel([a[1] for a in answers])

        def offer(k: int, models: list = models) -> None:
            for model, label in zip(models, stream.y[k], strict=True):
                model.add_point(stream.z[k], np.array([label]))

        with contextlib.redirect_stdout(io.StringIO()):
            update = _offered(offer, len(stream.z), before=lambda k, ask=predict: ask(stream.z[k]))
            query = each(predict, list(stream.queries[:SLOW_QUERIES]))
            answers = [predict(z) for z in stream.queries]
        found = accuracy(*(np.stack(part) for part in zip(*answers, strict=True)), stream, full, ours=False)
        where = "of all" if looked_at is None else f"of {looked_at} beside the last"
        name = f"SkyGP-BCM, {points} points an expert, nearest {nearest} {where}"
        rows.append(Timed(name, len(stream.z), None, None, *update, *query, **found))
    return rows


def _loaded(path: Path, name: str) -> Callable | None:
    """Return the class of that name in a file, or None, with a line that says why."""
    if not path.is_file():
        click.echo(f"left out: {name}, there is no {path.name} in the folder given", err=True)
        return None
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
        return getattr(module, name)
    except (ImportError, AttributeError) as error:
        click.echo(f"left out: {name}, {error}", err=True)
        return None


def _offered(
    offer: Callable[[int], None], count: int, before: Callable[[int], object] = lambda k: None
) -> tuple[float, float]:
    """Return percentiles of the time of each offer, the first ten left out as for ours."""
    times = []
    for k in range(count):
        before(k)
        times.append(spent(lambda at=k: offer(at)))
    return percentiles(times[10:])
