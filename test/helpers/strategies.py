"""Random rotations and transforms for hypothesis, with the numerically difficult ones."""

import numpy as np
from hypothesis import strategies as st

from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform

finite = st.floats(-50.0, 50.0, allow_subnormal=False)
vectors = st.tuples(finite, finite, finite).map(np.array)
axes = vectors.filter(lambda v: np.linalg.norm(v) > 1e-3).map(lambda v: v / np.linalg.norm(v))
angles = st.one_of(
    st.floats(0.0, np.pi),
    st.floats(-300.0, -3.0).map(lambda e: 10.0**e),  # near identity
    st.floats(-16.0, -3.0).map(lambda e: np.pi - 10.0**e),  # near 180 degrees
    st.sampled_from([0.0, np.pi, np.pi / 2]),
)
rotvecs = st.builds(lambda axis, angle: axis * angle, axes, angles)
matrices = rotvecs.map(matrix_from_rotvec)
transforms = st.builds(Transform, matrices, vectors)
