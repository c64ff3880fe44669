"""A lane change planned by acados with the exported model: nominal dynamics and learned residual in one step.

    split export my_car.split --target c --target casadi -o controller/
    python lane_change.py controller my_car [--speed 15] [--shift 3]

Needs a C compiler and acados: its library, `acados_template` and ACADOS_SOURCE_DIR, or the package that
docs/export.md names. acados compiles `my_car_acados.c` as its discrete dynamics. The planned states are then
followed with `my_car_step.casadi`, which knows nothing of acados, and the largest difference is printed.
"""

from __future__ import annotations

import argparse
import contextlib
from pathlib import Path
from time import perf_counter

import casadi
import numpy as np
from acados_template import AcadosModel, AcadosOcp, AcadosOcpSolver

#: The set's label interval [s] and how many of them are planned: 2 s.
STEP, STEPS = 0.05, 40
#: X, Y [m], yaw [rad], v_x, v_y [m/s], r [rad/s], T [N m], delta [rad]; then dT/dt [N m/s], ddelta/dt [rad/s].
WEIGHTS = np.array([0.0, 0.2, 5.0, 0.1, 0.0, 1.0, 1e-8, 1.0, 1e-8, 5.0])
LARGEST_ANGLE, LARGEST_ANGLE_RATE = 0.4, 1.0
LARGEST_TORQUE, LARGEST_TORQUE_RATE = 3000.0, 20_000.0


def lane_change(folder: Path, name: str, speed: float, shift: float, scratch: Path) -> AcadosOcpSolver:
    """Return the solver: from straight driving at `speed` [m/s] to `shift` [m] to the left, as WEIGHTS ask."""
    model = AcadosModel()
    model.name = name
    start = first_state(folder, name, speed)
    states = len(start)
    model.x, model.u = casadi.SX.sym("x", states), casadi.SX.sym("u", 2)
    model.disc_dyn_expr = model.x  # acados asks for one and, with generic functions, uses it for its size alone
    model.dyn_ext_fun_type = "generic"
    model.dyn_generic_source = f"{name}_acados.c"
    model.dyn_disc_fun = f"{name}_acados_fun"
    model.dyn_disc_fun_jac = f"{name}_acados_fun_jac"

    ocp = AcadosOcp()
    ocp.model = model
    recent = hasattr(ocp, "code_gen_options")  # before 2026 acados called these otherwise
    written, compiled = (ocp.code_gen_options,) * 2 if recent else (ocp, ocp.solver_options)
    written.code_export_directory = str(scratch / "c_generated_code")
    # The adapter includes CasADi's C, which lies beside it.
    compiled.ext_fun_compile_flags = f"-O2 -I{folder}"
    if recent:
        ocp.code_gen_options.json_file, ocp.solver_options.N_horizon = "lane_change.json", STEPS
    else:
        ocp.dims.N = STEPS
    ocp.solver_options.tf = STEPS * STEP
    ocp.solver_options.integrator_type = "DISCRETE"
    ocp.solver_options.hessian_approx = "GAUSS_NEWTON"
    ocp.solver_options.nlp_solver_type = "SQP"
    ocp.solver_options.qp_solver = "PARTIAL_CONDENSING_HPIPM"
    ocp.solver_options.nlp_solver_max_iter = 100

    goal = np.zeros(states)
    goal[1], goal[3] = shift, speed
    weights = np.insert(WEIGHTS, 8, np.zeros(states - 8))
    ocp.cost.cost_type, ocp.cost.cost_type_e = "LINEAR_LS", "LINEAR_LS"
    ocp.cost.W, ocp.cost.W_e = np.diag(weights), np.diag(weights[:states])
    ocp.cost.Vx, ocp.cost.Vx_e = np.eye(states + 2, states), np.eye(states)
    ocp.cost.Vu = np.eye(states + 2, 2, -states)
    ocp.cost.yref, ocp.cost.yref_e = np.append(goal, [0.0, 0.0]), goal
    ocp.constraints.x0 = start
    ocp.constraints.idxbx = np.array([6, 7])
    ocp.constraints.ubx = np.array([LARGEST_TORQUE, LARGEST_ANGLE])
    ocp.constraints.lbx = -ocp.constraints.ubx
    ocp.constraints.idxbu = np.array([0, 1])
    ocp.constraints.ubu = np.array([LARGEST_TORQUE_RATE, LARGEST_ANGLE_RATE])
    ocp.constraints.lbu = -ocp.constraints.ubu
    solver = AcadosOcpSolver(ocp, verbose=False)
    for stage in range(STEPS + 1):
        solver.set(stage, "x", start + speed * STEP * stage * np.eye(states)[0])
    return solver


def first_state(folder: Path, name: str, speed: float) -> np.ndarray:
    """Return straight driving at `speed` [m/s]: eight states, and those of the model's memory, settled."""
    straight = np.array([0.0, 0.0, 0.0, speed, 0.0, 0.0, 0.0, 0.0])
    remembered = folder / f"{name}_start.casadi"
    if not remembered.exists():
        return straight
    return casadi.Function.load(str(remembered))(straight).full().ravel()


def main() -> None:
    """Plan once and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="what `split export` wrote")
    parser.add_argument("name", help="prefix of its files")
    parser.add_argument("--speed", type=float, default=15.0, help="[m/s]")
    parser.add_argument("--shift", type=float, default=3.0, help="to the left [m]")
    parser.add_argument("--scratch", type=Path, default=Path("acados_build"), help="for acados' own files")
    asked = parser.parse_args()
    folder, scratch = asked.folder.resolve(), asked.scratch.resolve()
    scratch.mkdir(parents=True, exist_ok=True)
    step = casadi.Function.load(str(folder / f"{asked.name}_step.casadi"))
    with contextlib.chdir(folder):  # acados looks for the adapter where it runs
        solver = lane_change(folder, asked.name, asked.speed, asked.shift, scratch)
    begin = perf_counter()
    status = solver.solve()
    seconds = perf_counter() - begin
    x = np.array([solver.get(stage, "x") for stage in range(STEPS + 1)])
    u = np.array([solver.get(stage, "u") for stage in range(STEPS)])
    followed = np.array([step(x[k], u[k], STEP).full().ravel() for k in range(STEPS)])
    scale = np.maximum(np.abs(x).max(axis=0), 1e-3)
    spent = f"{solver.get_stats('sqp_iter')} iterations, {1e3 * seconds:.1f} ms"
    print(f"status {status}, {spent}, cost {solver.get_cost():.4g}")
    apart = np.abs((followed - x[1:]) / scale).max()
    print(f"largest difference of a state from {asked.name}_step.casadi: {apart:.2g} of its largest value")
    print(" t/s    X/m    Y/m  yaw/rad  v_x/m/s  v_y/m/s  r/rad/s   T/Nm  delta/rad")
    for k in range(0, STEPS + 1, 8):
        print("{:4.2f} {:6.2f} {:6.3f} {:8.4f} {:8.3f} {:8.4f} {:8.4f} {:6.0f} {:10.5f}".format(k * STEP, *x[k, :8]))


if __name__ == "__main__":
    main()
