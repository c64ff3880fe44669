from dataclasses import dataclass


@dataclass(frozen=True)
class DelayEstimate:
    channel: str


def estimate_delays(*a):
    return ()
