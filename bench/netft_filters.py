"""The filters of the NetFT driver: gain at rest, delay, and what each part costs per batch."""

from __future__ import annotations

import numpy as np

from bench.report import options, show, show_calls
from crtk_driver_ati_netft import rdt
from crtk_driver_ati_netft.pipeline import Pipeline
from crtk_driver_ati_netft.stream import Batch
from crtk_drivers.kit.clock_fit import ClockFit
from crtk_drivers.kit.sensing.filters import Filter, LowPass, Mean
from crtk_drivers.kit.sensing.sequence import SequenceTracker

RATE = 7000.0
LOAD = np.array([123.456, -7.1, 0.001, 3.3, -0.02, 5e-4])


def step_answer(maker: Filter) -> tuple[float, float]:
    """Return the error of the gain at rest, and the delay of a ramp in ms."""
    maker.take(np.zeros((100, 6)))
    end = None
    for _ in range(200):
        result = maker.take(np.tile(LOAD, (140, 1)))
        end = result if result is not None else end
    assert end is not None
    error = float(np.abs(end / LOAD - 1.0).max())
    maker.reset()
    ramp = np.arange(21000.0)[:, None]
    result = maker.take(ramp)
    assert result is not None
    return error, (ramp[-1 - maker.rest, 0] - result[0]) / RATE * 1e3


def show_parts(size: int) -> None:
    """Print what the parts cost for batches of `size`."""
    records = np.zeros(size, rdt.RECORD)
    slots = records.view(np.uint8).reshape(size, -1)
    lengths = np.full(size, rdt.RECORD_SIZE, np.uint32)
    tracker, clock, pipeline = SequenceTracker(RATE), ClockFit(), Pipeline(500.0, None, np.eye(6))
    low = LowPass(100.0, RATE)
    state = {"first": 1}
    values, status = np.ones((size, 6)), np.zeros(size, np.uint32)

    def numbers() -> tuple[np.ndarray, np.ndarray]:
        first = state["first"]
        state["first"] = first + size
        counted = np.arange(first, first + size)
        return counted, 10.0 + counted / RATE

    def track() -> None:
        counted, times = numbers()
        tracker.take(counted.astype(np.uint32), counted.astype(np.uint32), times)

    def stamp() -> None:
        clock.stamp(*numbers())

    def pipe() -> None:
        counted, times = numbers()
        batch = Batch(counted.astype(np.uint32), counted, status, values, times)
        pipeline.take(batch, RATE)

    show_calls(
        f"One batch of {size} measurements",
        {
            "decode": lambda: rdt.native(rdt.decode_batch(slots, lengths).records),
            "sequence": track,
            "stamps": stamp,
            "block, compensation, mean": pipe,
            "low-pass": lambda: low.take(values),
        },
        500,
    )


def main() -> None:
    """Measure and print."""
    options(__doc__ or "")
    makers: dict[str, Filter] = {
        "mean of 14 (500 Hz)": Mean(14),
        "mean of 70 (100 Hz)": Mean(70),
        **{
            f"low-pass {cutoff:g} Hz": LowPass(cutoff, RATE) for cutoff in (5.0, 20.0, 100.0, 500.0)
        },
    }
    rows = []
    for name, maker in makers.items():
        error, delay = step_answer(maker)
        rows.append((name, f"{error:.1e}", f"{delay:.3f}", f"{maker.delay / RATE * 1e3:.3f}"))
    columns = ("filter at 7000 Hz", "gain at rest - 1", "delay ms", "as the driver says")
    show("NetFT filters", columns, rows)
    for size in (1, 14, 70):
        show_parts(size)


if __name__ == "__main__":
    main()
