/* Lower bounds of the distance from ground: machine/clusters/height_bounds.py. */
#ifndef BACKHOE_RINGS
#define BACKHOE_RINGS
#include "arrays.h"

#include <math.h>

/* the highest of the ground in rings around the cells of a region, see `lower_over_heights` */
typedef struct {
    double low[2], per_cell[2], furthest, box[6];
    const npy_intp *counts;
    const float *highest;
    Vec squares;
} Rings;

/* how far it is from the interval between `low` and `high` to the one between `from` and `to` */
static inline double gap_between(double low, double high, double from, double to)
{
    return fmax(fmax(from - high, low - to), 0.0);
}

/* The last seven arguments of `lower_over_heights`; 0, or -1 with an exception. */
int read_rings(PyObject *const *args, Rings *rings);
/* What is known of the distance of a point in the frame of the ground. */
double lower_by_rings(const Rings *rings, const double *point);

#endif
