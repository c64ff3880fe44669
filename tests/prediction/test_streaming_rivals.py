"""The seam for learners of others: what code in a folder answers stands in the rows; an empty one is left out."""

import builtins

import numpy as np

from tests.benchmarks.rival_stream import stream_of
from tests.benchmarks.streaming_rivals import POINTS, log_gp_rows, sky_gp_rows

#: Stand-ins with the calls of the rivals. They are told the truth of the stream: errors and density are known.
LOG = """
class LoGGP:
    def __init__(self, inputs, outputs, points, leaves, ard):
        self.seen, self.room = 0, points * leaves
    def update(self, x, y):
        self.seen += 1
        assert self.seen <= self.room and x.shape == (3,) and y.shape == (3,)
    def predict(self, x):
        return TRUTH[tuple(x)] + self.sigmaF
"""
SKY = """
class SkyGP_BCM:
    def __init__(self, inputs, outputs, **settings):
        self.deviation = settings["pretrained_params"][0]
        self.asked, self.expert_weights = None, [0.5]
    def predict(self, x):
        assert self.expert_weights == [1.0], "an expert is forgotten"
        self.asked = x
        return self.deviation * 0.0, self.deviation**2
    def add_point(self, x, y):
        assert self.asked is x or (self.asked == x).all()
        self.update_param_incremental(x, y, 0)
    def update_param_incremental(self, x, y, model):
        assert isinstance(y, float)
"""


def test_rows_hold_what_the_code_in_the_folder_answers(tmp_path, monkeypatch):
    stream = stream_of(60, 2.0)
    truth = {tuple(z): value for z, value in zip(stream.queries, stream.truth, strict=True)}
    (tmp_path / "models").mkdir()
    (tmp_path / "LoGGP.py").write_text(LOG)
    (tmp_path / "models" / "SkyGP_BCM.py").write_text(SKY)
    monkeypatch.setattr(builtins, "TRUTH", truth, raising=False)
    log = log_gp_rows(tmp_path, stream, None)
    # A signal deviation beside the truth everywhere is an error of one, and no variance is made up.
    np.testing.assert_allclose([row.rmse for row in log], 1.0, rtol=1e-12)
    assert len(log) == len(POINTS) and all(row.nlpd is None and row.coverage_95 is None for row in log)
    # The prior alone: the error is the truth's own size, and its density is that of a unit Gaussian.
    row = sky_gp_rows(tmp_path, stream, None)[0]
    scaled = stream.truth / np.sqrt(stream.trained.kernel.signal_variance)
    np.testing.assert_allclose(row.rmse, np.sqrt(np.mean(scaled**2)), rtol=1e-12)
    np.testing.assert_allclose(row.nlpd, np.mean(0.5 * np.log(2 * np.pi) + 0.5 * scaled**2), rtol=1e-12)


def test_a_folder_without_their_code_is_left_out_and_said_so(tmp_path, capsys):
    stream = stream_of(60, 2.0)
    assert log_gp_rows(tmp_path, stream, None) == [] and sky_gp_rows(tmp_path, stream, None) == []
    assert "LoGGP.py" in capsys.readouterr().err
