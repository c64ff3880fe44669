"""Work in threads gives what work in turn gives."""

import os
import pickle
import threading

import numpy as np
import pytest

from split_cli.diagnosis import parallel as module
from split_cli.diagnosis.parallel import distributing_by, map_distributed_with, map_in_threads, use_threads
from split_cli.vehicle.effects import CATALOGUE
from tests.diagnosis.recordings import driven, noisy_objective


@pytest.fixture(params=[1, 3])
def threads(request):
    use_threads(request.param)
    yield request.param
    use_threads(0)


def test_results_are_in_order_and_errors_come_out(threads):
    assert map_in_threads(lambda x: x * x, range(7)) == [x * x for x in range(7)]
    assert map_in_threads(lambda x: x, []) == []

    def fails(x: int) -> int:
        if x:
            raise ValueError(x)
        return x

    with pytest.raises(ValueError, match="^2$"):
        map_in_threads(fails, [0, 2, 5])


def test_several_are_under_way_at_once_where_they_may_be(threads):
    """Each waits for the others: in turn they never meet."""
    gate = threading.Barrier(3)

    def meets(_) -> bool:
        try:
            gate.wait(timeout=0.5 if threads == 1 else 20.0)
        except threading.BrokenBarrierError:
            return False
        return True

    assert map_in_threads(meets, range(3)) == [threads == 3] * 3


def test_there_are_no_more_threads_than_cores_or_four(monkeypatch):
    seen = []
    monkeypatch.setattr(module, "ThreadPoolExecutor", lambda count: seen.append(count) or Pool())
    for cores in (2, 64):
        monkeypatch.setattr(os, "sched_getaffinity", lambda _, cores=cores: set(range(cores)), raising=False)
        map_in_threads(str, range(9))
    assert seen == [2, 4]


class Pool:
    """A pool that works in turn."""

    def __enter__(self):
        return self

    def __exit__(self, *_) -> None:
        pass

    map = staticmethod(map)


def test_what_travels_forgets_what_it_found_by_ids():
    """Another process gives the ids of objects to others, where remembered rows would be found."""
    here = noisy_objective(driven(41, []), 3)
    drag = CATALOGUE["aero_drag"]({"drag": 0.1})
    left = here.residual([drag])
    here.memo["kinematics", id(here)] = {}
    there = pickle.loads(pickle.dumps(here))
    assert here.memo and not there.memo
    assert here.evidence[0].series._nominal_flows and not there.evidence[0].series._nominal_flows
    assert np.array_equal(there.residual([drag]), left)


def test_what_is_held_comes_first():
    assert map_distributed_with(10, lambda held, item: held - item, [3, 4]) == [7, 6]
    with distributing_by(lambda function, items: [function.func(*function.args, item) for item in reversed(items)]):
        assert map_distributed_with(10, lambda held, item: held - item, [3, 4]) == [6, 7]
