"""One place for the compiler options of the physics kernels."""

from numba import njit

# Sums may be reordered and products contracted (that is what lets short loops use vector instructions); NaN and
# infinity keep their meaning, because the results are checked for them.
kernel = njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})
