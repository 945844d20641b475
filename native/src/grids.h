/* Lower bounds of distances on a grid: machine/clusters/distance_grid.py. */
#ifndef BACKHOE_GRIDS
#define BACKHOE_GRIDS
#include "arrays.h"
#include "asked.h"

/* the cells of a grid; the last axis varies fastest */
typedef struct {
    double low[3], per_step;
    npy_intp counts[3];
} Frame;

/* a bound for each cell, and the box that counts for points outside of the grid */
typedef struct {
    Frame frame;
    const char *values; /* floats */
    npy_intp step;
    double box[6];
} Grid;

enum { OF_FRAME = 3, OF_GRID = 5 };
int read_frame(PyObject *const *args, Frame *frame); /* low, per_step, counts; 0, or -1 with an exception */
int has_cells(npy_intp length, const Frame *frame);  /* whether there is one for each cell; if not, with an exception */
int read_grid(PyObject *const *args, Grid *grid);    /* the last five arguments of `lower_on_grid` */
/* The number of the cell that a point is in, or is nearest to; whether the point is inside of the grid in `inside`. */
npy_intp cell_at(const Frame *frame, const double *point, int *inside);
double lower_at(const Grid *grid, const double *point);

/* pieces asked about, with balls around them on two levels, and a grid */
typedef struct {
    Asked asked;
    Balls coarse, fine;
    Grid grid;
} Covered;

enum { OF_COVERED = OF_ASKED + 2 * OF_BALLS + OF_GRID };
int read_covered(PyObject *const *args, Covered *covered); /* the arguments of `least_on_grid`; 0, or -1 with an exception */
double least_on_grid_of(const Covered *covered, npy_intp k); /* the answer of `least_on_grid` to question k */

#endif
