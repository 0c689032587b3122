"""Types of numpy arrays, by element."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int64]
Bits = NDArray[np.bool_]
Bytes = NDArray[np.uint8]
