"""How likely a pixel beside a jump has the disparity of the wrong surface: a network with one hidden layer.

Its weights are learnt on rendered ground, where the truth is known (`tools/train_edge_network.py`).
"""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.jit import jit_rows
from sfr_loc_map.mapping.disparity.edge_evidence import Scene, edge_evidence

F = np.float32


class Network(NamedTuple):
    """A network with one hidden layer of rectified linear units.

    Attributes:
        low: `(15,)` float32. Evidence is clipped to the range that was common where the weights were learnt.
        high: `(15,)` float32, likewise.
        hidden: `(K, 15)` float32, weights of the evidence.
        hidden_offset: `(K,)` float32.
        output: `(K,)` float32, weights of the hidden layer.
        output_offset: `(1,)` float32.
    """

    low: FloatImage
    high: FloatImage
    hidden: FloatImage
    hidden_offset: FloatImage
    output: FloatImage
    output_offset: FloatImage


@cache
def edge_network() -> Network:
    """Return the network that is part of the suite."""
    text = files("sfr_loc_map.mapping.disparity").joinpath("edge_network.json").read_text(encoding="utf-8")
    weights = json.loads(text)
    return Network(*(np.asarray(weights[name], F) for name in Network._fields))


@jit_rows
def log_odds(network: Network, evidence: FloatImage) -> FloatImage:
    """Return the log odds `(N,)` that a pixel's surface is the wrong one, of its evidence `(N, 15)`."""
    low, high = network.low, network.high
    hidden, hidden_offset, output = network.hidden, network.hidden_offset, network.output
    out = np.empty(len(evidence), F)
    for n in prange(len(evidence)):
        total = network.output_offset[0]
        for k in range(len(output)):
            unit = hidden_offset[k]
            for i in range(hidden.shape[1]):
                unit += hidden[k, i] * min(max(evidence[n, i], low[i]), high[i])
            total += output[k] * max(unit, F(0.0))
        out[n] = total
    return out


def wrong_surface_log_odds(scene: Scene, chosen: NDArray[np.int64]) -> FloatImage:
    """Return the log odds `(N,)` that pixels, given by their places in the flat image, are on the wrong surface."""
    return log_odds(edge_network(), edge_evidence(scene, chosen))
