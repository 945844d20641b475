/* Cells of clusters, by tiles and one by one, and the boxes around them. */
#ifndef BACKHOE_CELLS
#define BACKHOE_CELLS
#include "arrays.h"
#include "distance.h"

int as_three(PyObject *object, const char *name, double *out);
int as_numbers(PyObject *object, const char *name, npy_intp length, Ind *out); /* no indices: they are not looked at */

/* the box around a link along axes of its own: see `off_turned_box` */
typedef struct {
    double R[9], middle[3], half[3], radius;
} Box;

double off_box(const Box *box, double x, double y, double z);

/* the arguments of `cells_of_tiles` that say where the cells are */
typedef struct {
    double origin[3], spread[3], edge;
    Ind counts, number, start;
    Mat middle;
    Vec size;
} Tiles;

enum { OF_TILES = 8 };
int as_tiles(PyObject *const *args, Tiles *tiles);
/* the tiles that may touch the box from `low` to `high` and a link within reach: how many, to be released; or -1 */
npy_intp tiles_near(const Tiles *tiles, const double *low, const double *high, const Box *box, double reach, Room *room,
                    npy_intp **found);

/* K cubes, then T triangles, as a CellSet has them */
typedef struct {
    Mat middle;
    Vec half;
    const char *corners; /* (3, 3, T) */
    npy_intp cubes, all, step[3];
} Cells;

int as_cells(PyObject *const *args, Cells *cells);

/* a link and the rules by which boxes around cells are found, see `boxes_of_cells` */
typedef struct {
    Hull hull;       /* from `base` */
    double base[3];
    Mat R, placed;   /* the link's axes, and those of the solid in the world */
    Vec at;          /* where the solid is */
    double rules[4]; /* the link's radius, slack, the finest cell, and what counts as behind */
} Finding;

/* Boxes around cells whose middles are `off` the link: the result of `boxes_of_cells`, but for what is left. `those`
 * holds the numbers of the cells that are left, and `left` how many; -1 where it takes coal. */
PyObject *find_boxes(const Cells *cells, const Vec *off, const Finding *finding, npy_intp most, npy_intp *those,
                     npy_intp *left);

#endif
