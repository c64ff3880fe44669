"""GPyTorch's exact process beside ours: its query, and an update followed by a query."""

import gc
import resource
import time

import click
import numpy as np

from tests.benchmarks.rival_stream import SLOW_QUERIES, Samples, Timed, accuracy, percentiles, spent


def gpytorch_rows(stream: Samples, full: np.ndarray | None, alone: bool = False) -> list[Timed]:
    """Time GPyTorch's exact process: cached, and each query after an update; nothing where it is not installed.

    The three outputs are one batch or, `alone`, one after the other, which takes a third of the memory; times are
    then sums over the outputs.
    """
    try:
        import gpytorch
        import torch
    except ImportError:
        click.echo("GPyTorch is not installed (pip install gpytorch): its rows are left out", err=True)
        return []
    torch.set_num_threads(1)
    s, (points, labels) = stream.rivals, stream.points
    z = torch.tensor(points)

    class Exact(gpytorch.models.ExactGP):
        def __init__(self, x, targets, likelihood):
            super().__init__(x, targets, likelihood)
            batch = targets.shape[:1]
            self.mean_module = gpytorch.means.ZeroMean(batch_shape=batch)
            self.covar_module = gpytorch.kernels.ScaleKernel(
                gpytorch.kernels.RBFKernel(ard_num_dims=3, batch_shape=batch), batch_shape=batch
            )

        def forward(self, x):
            return gpytorch.distributions.MultivariateNormal(self.mean_module(x), self.covar_module(x))

    def fresh(outputs: list[int]):
        size = len(outputs)
        likelihood = gpytorch.likelihoods.GaussianLikelihood(batch_shape=torch.Size([size]))
        model = Exact(z.expand(size, *z.shape), torch.tensor(labels.T[outputs].copy()), likelihood).double()
        model.covar_module.outputscale = torch.tensor(s.signal_variance[outputs])
        model.covar_module.base_kernel.lengthscale = torch.tensor(s.length_scales[outputs]).reshape(size, 1, 3)
        likelihood.noise = torch.tensor(s.noise_variance[outputs]).reshape(size, 1)
        return model.eval()

    def ask(model, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        with torch.no_grad(), gpytorch.settings.fast_pred_var():
            found = model(torch.tensor(at).expand(*model.train_targets.shape[:1], *at.shape))
            return found.mean.numpy().T, found.variance.numpy().T

    few = 3 if len(points) > 2000 else 8
    build, cached, anew, answers = 0.0, np.zeros(SLOW_QUERIES), np.zeros(few), []
    for outputs in ([0], [1], [2]) if alone else ([0, 1, 2],):
        begin = time.perf_counter()
        model = fresh(outputs)
        ask(model, stream.queries[:1])
        build += time.perf_counter() - begin
        cached += [spent(lambda at=q, to=model: ask(to, at[None])) for q in stream.queries[:SLOW_QUERIES]]
        answers.append(ask(model, stream.queries))
        del model
        gc.collect()  # a model and its caches refer to each other
        anew += [spent(lambda at=q, of=outputs: ask(fresh(of), at[None])) for q in stream.queries[:few]]
    mean, variance = (np.concatenate(part, axis=1) for part in zip(*answers, strict=True))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0 if alone else None
    how = ", one output after the other" if alone else ""
    size, count = len(stream.z), len(points)
    return [
        Timed(
            f"GPyTorch, exact{how}",
            size,
            count,
            build,
            None,
            None,
            *percentiles(list(cached)),
            **accuracy(mean, variance, stream, full, ours=False),
            megabytes=peak,
        ),
        Timed(f"GPyTorch, update then predict{how}", size, count, None, None, None, *percentiles(list(anew))),
    ]
