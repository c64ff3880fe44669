"""A model predictive controller of your own on an exported model, driven through the cones of ISO 3888-1.

    split export my_car.split --target casadi -o controller/
    python docs/recipes/lane_change_mpc.py controller my_car --speed 22

The controller needs numpy and casadi, and of this project only the exported files. `simulated_car` stands in for a
car: it is the project's plant with noisy sensors. Replace it by your own.
"""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import thread_time

import casadi
import numpy as np

#: Control interval [s] and how many of them are planned: 1.5 s.
STEP, STEPS = 0.05, 30
#: Weights of the distance from the line [1/m^2], the yaw angle beside it [1/rad^2], the speed error [s^2/m^2], and
#: of the inputs dT/dt [s^2/(N m)^2] and ddelta/dt [s^2/rad^2].
LINE, YAW, SPEED, INPUTS = 1.0, 5.0, 0.1, np.array([1e-9, 0.5])
#: |T| [N m], |delta| [rad], |dT/dt| [N m/s] and |ddelta/dt| [rad/s] at most.
LARGEST, LARGEST_RATES = np.array([2000.0, 0.4]), np.array([20_000.0, 0.6])


class LaneChangeMpc:
    """Steers along a line y(x): each interval linearises the model about its last plan and solves one programme.

    Parameters
    ----------
    folder : path
        What `split export --target casadi` wrote.
    name : str
        Prefix of its files.
    line : callable
        x, shape (N,) [m], to y [m] and its slope [1].
    speed : float
        To be kept [m/s].

    Notes
    -----
    The states are x = [X, Y, yaw, v_x, v_y, r, T, delta] and what the model's effects remember, the inputs
    u = [dT/dt, ddelta/dt]. With dx and du for the way from the last plan, dx_{k+1} = A_k dx_k + B_k du_k + c_k is
    put into the cost, and du is all that the programme has to find.
    """

    def __init__(self, folder: Path, name: str, line: Callable, speed: float) -> None:
        step = casadi.Function.load(str(Path(folder) / f"{name}_step.casadi"))
        if step.n_in() > 3:
            raise SystemExit(f"{name} has effects of time or place, which this example does not pass on")
        self.line, self.speed, self.n = line, speed, step.size1_in(0)
        x, u = casadi.MX.sym("x", self.n), casadi.MX.sym("u", 2)
        following = step(x, u, STEP)
        results = [following, casadi.jacobian(following, x), casadi.jacobian(following, u)]
        # As compiled C, with `cc`, an interval takes a tenth of the time that CasADi's interpreter takes.
        options = {"jit": True, "compiler": "shell", "jit_options": {"flags": ["-O2"]}}
        compiled = options if shutil.which("cc") else {}
        self._model = casadi.Function("model", [x, u], [casadi.densify(one) for one in results], compiled)
        self._along = self._model.map(STEPS)
        start = Path(folder) / f"{name}_start.casadi"
        self._start = casadi.Function.load(str(start)) if start.exists() else None
        size = 2 * STEPS
        shape = {"h": casadi.Sparsity.dense(size, size), "a": casadi.Sparsity.dense(size, size)}
        self._solve = casadi.conic("programme", "daqp", shape)
        self.x: np.ndarray | None = None

    def command(self, measured: np.ndarray) -> np.ndarray:
        """Return the input for the interval after this one; call it once an interval.

        Parameters
        ----------
        measured : ndarray, shape (8,)
            X, Y, yaw, v_x, v_y, r, and the commanded T and delta.
        """
        if self.x is None:
            self._begin(measured)
        # What was commanded before acts now; the new input follows one interval later.
        now = self.follow(np.concatenate([measured, self._memory]), self.u[0])
        self._memory = now[8:]
        self.x, self.u = np.vstack([self.x[1:], self.x[-1:]]), np.vstack([self.u[1:], self.u[-1:]])
        self.x[-1] = self.follow(self.x[-2], self.u[-1])
        self._improve(now)
        return self.u[0]

    def follow(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the state one interval later, shape (n,)."""
        return self._model(x, u)[0].full().ravel()

    def _begin(self, measured: np.ndarray) -> None:
        whole = measured if self._start is None else self._start(measured).full().ravel()
        self._memory = whole[8:]
        self.u, self.x = np.zeros((STEPS, 2)), np.tile(whole, (STEPS + 1, 1))
        for k in range(STEPS):
            self.x[k + 1] = self.follow(self.x[k], self.u[k])

    def _improve(self, now: np.ndarray) -> None:
        """Solve one programme about the plan, and take its answer for the plan."""
        n, found = self.n, self._along(self.x[:-1].T, self.u.T)
        following, A, B = (one.full() for one in found)
        gap = following.T - self.x[1:]
        # dx_k = G_k du + g_k, all du in one vector
        G, g = np.zeros((STEPS + 1, n, 2 * STEPS)), np.zeros((STEPS + 1, n))
        g[0] = now - self.x[0]
        for k in range(STEPS):
            Ak, Bk = A[:, n * k : n * (k + 1)], B[:, 2 * k : 2 * k + 2]
            G[k + 1], g[k + 1] = Ak @ G[k], Ak @ g[k] + gap[k]
            G[k + 1, :, 2 * k : 2 * k + 2] += Bk
        x, G, g = self.x[1:], G[1:], g[1:]
        y, slope = self.line(x[:, 0])
        beside = G[:, 1] - slope[:, None] * G[:, 0], x[:, 1] - y + g[:, 1] - slope * g[:, 0]
        turned = G[:, 2], x[:, 2] - np.arctan(slope) + g[:, 2]
        slower = G[:, 3], x[:, 3] - self.speed + g[:, 3]
        costs = np.tile(INPUTS, STEPS)
        H, q = np.diag(costs), costs * self.u.ravel()
        for weight, (matrix, error) in zip((LINE, YAW, SPEED), (beside, turned, slower), strict=True):
            H, q = H + weight * matrix.T @ matrix, q + weight * matrix.T @ error
        reached = (x[:, 6:8] + g[:, 6:8]).ravel()
        bound, rate = np.tile(LARGEST, STEPS), np.tile(LARGEST_RATES, STEPS)
        scale = rate  # inputs of one size help any solver
        answer = self._solve(
            h=H * scale * scale[:, None],
            g=q * scale,
            a=G[:, 6:8].reshape(2 * STEPS, -1) * scale / bound[:, None],
            lba=(-bound - reached) / bound,
            uba=(bound - reached) / bound,
            lbx=-1.0 - self.u.ravel() / scale,
            ubx=1.0 - self.u.ravel() / scale,
        )
        change = answer["x"].full().ravel() * scale
        if not self._solve.stats()["success"]:
            return  # the last plan goes on
        self.u = self.u + change.reshape(-1, 2)
        self.x = np.vstack([now, x + G @ change + g])


@dataclass
class LaneChange:
    """What came of one drive: largest distance from the line [m], cones hit, processor time a step [ms]."""

    deviation: float
    hit: int
    median_ms: float


def simulated_car(folder: Path, name: str, speed: float, seed: int = 0, grip: float = 1.0) -> LaneChange:
    """Drive the project's plant through ISO 3888-1 at `speed` [m/s] with the controller above."""
    from split_cli.control.scenarios import build_scenario, cones_hit
    from split_cli.plant.cars import find_car
    from split_cli.workflows.racing.closed_loop import World, body_ends, body_width

    car = find_car("road_car")
    scenario = build_scenario("iso3888-1", body_width(car), speed)
    path, world = scenario.path, World(car, scenario.path, speed, friction=grip, seed=seed)

    def line(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.interp(x, path.x, path.y), np.interp(x, path.x, np.gradient(path.y, path.x))

    controller = LaneChangeMpc(folder, name, line, speed)
    applied, spent = np.zeros(2), []
    while world.exact[0] < path.x[0] + scenario.finish and not world.spun:
        start = thread_time()
        following = controller.command(world.measured)
        spent.append(thread_time() - start)
        world.drive(applied, STEP)
        applied = following
    truth = np.array(world.truth)
    x, y, yaw = truth[:, 1], truth[:, 2], truth[:, 3]
    hit = cones_hit(scenario.cones, x, y, yaw, *body_ends(car), body_width(car))
    between = (x >= 0.0) & (x <= scenario.lanes[-1].end)
    return LaneChange(float(np.abs(y - line(x)[0])[between].max()), int(hit.sum()), 1e3 * float(np.median(spent)))


def main() -> None:
    """Drive once and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="what `split export` wrote")
    parser.add_argument("name", help="prefix of its files")
    parser.add_argument("--speed", type=float, default=20.0, help="[m/s]")
    parser.add_argument("--grip", type=float, default=1.0, help="friction of the road [1]")
    parser.add_argument("--seed", type=int, default=0, help="of the sensors' noise")
    asked = parser.parse_args()
    done = simulated_car(asked.folder, asked.name, asked.speed, asked.seed, asked.grip)
    print(f"{asked.name} at {asked.speed:g} m/s: {done.hit} cones hit,", end=" ")
    print(f"at most {done.deviation:.2f} m from the line")
    print(f"{done.median_ms:.1f} ms a step in the median")


if __name__ == "__main__":
    main()
