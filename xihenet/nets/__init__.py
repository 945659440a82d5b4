"""Network definitions in torch, for training; start-up never imports them."""

from __future__ import annotations

from typing import Any

import numpy as np

from xihenet.estimators.base import Target
from xihenet.estimators.weights_format import NetworkWeights


def weights_of(net: Any, target: Target, **notes: Any) -> NetworkWeights[Any]:
    """What `save_weights` keeps of a torch network; `notes` are its estimator, data, seed, figures and n_points."""
    arrays = {name: value.detach().cpu().numpy().astype(np.float32) for name, value in net.state_dict().items()}
    return NetworkWeights(net.architecture, target, arrays, **notes)
