/* How near a convex shape is to the surface of a height map: machine/clusters/terrain.py. */
#include "arrays.h"
#include "distance.h"

#include <math.h>
#include <string.h>

static double along(const double *n, const double *x)
{
    return n[0] * x[0] + n[1] * x[1] + n[2] * x[2];
}

/* a height map, from `base` */
typedef struct {
    Mat heights;
    Vec x, y;
    double base[3];
} Map;

/* the corners of a cell: those of its first row, then those of its second */
static void corners_of(const Map *map, npy_intp row, npy_intp column, double (*corners)[3])
{
    for (int k = 0; k < 4; k++) {
        const npy_intp i = row + k / 2, j = column + k % 2;
        corners[k][0] = AT(map->x, j) - map->base[0];
        corners[k][1] = AT(map->y, i) - map->base[1];
        corners[k][2] = AT2(map->heights, i, j) - map->base[2];
    }
}

/* how far it is from the interval between `low` and `high` to the one between `from` and `to` */
static double gap_between(double low, double high, double from, double to)
{
    return fmax(fmax(from - high, low - to), 0.0);
}

/* The square of how far the column under a cell's highest corner is from the box around the shape. */
static double squared_off(const double (*corners)[3], const double *low, const double *high)
{
    const double aside = gap_between(low[0], high[0], corners[0][0], corners[3][0]);
    const double beside = gap_between(low[1], high[1], corners[0][1], corners[3][1]);
    const double top = fmax(fmax(corners[0][2], corners[1][2]), fmax(corners[2][2], corners[3][2]));
    const double above = fmax(low[2] - top, 0.0);
    return aside * aside + beside * beside + above * above;
}

/* the nearest place found, see `nearest_on_ground` */
typedef struct {
    double distance, normal[3], on_shape[3], on_ground[3];
} Nearest;

/* Look at the two triangles of a cell for what is nearer than `found`: 1 where something is, 0, or -1 undecided. */
static int look_at_cell(const Hull *shape, const double (*corners)[3], Nearest *found)
{
    const int main = corners[0][2] + corners[3][2] >= corners[1][2] + corners[2][2]; /* the higher diagonal */
    int nearer = 0;
    for (int triangle = 0; triangle < 2; triangle++) {
        double points[9], guess[3];
        const int ends[2][3] = {{0, 1, main ? 3 : 2}, {main ? 0 : 1, 3, 2}};
        for (int k = 0; k < 3; k++)
            memcpy(points + 3 * k, corners[ends[triangle][k]], sizeof(guess));
        const Hull other = {points, 3};
        memcpy(guess, found->normal, sizeof(guess));
        if (come_nearer(furthest_on_hull, shape, &other, found->distance, guess) == 0)
            continue;
        Nearest here;
        if (hull_distance(shape, &other, &here.distance, here.normal, here.on_shape, here.on_ground) < 0)
            return -1;
        if (here.distance < found->distance)
            *found = here, nearer = 1;
    }
    return nearer;
}

/* Look at all cells, first at the one that may be nearest; as `look_at_cell`. */
static int look_at_map(const Map *map, const Hull *shape, Nearest *found)
{
    const npy_intp rows = map->heights.rows - 1, columns = map->heights.columns - 1;
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY}, corners[4][3];
    for (ptrdiff_t k = 0; k < shape->count; k++)
        for (int c = 0; c < 3; c++)
            low[c] = fmin(low[c], shape->points[3 * k + c]), high[c] = fmax(high[c], shape->points[3 * k + c]);
    double least = INFINITY;
    npy_intp first_row = 0, first_column = 0;
    for (npy_intp i = 0; i < rows; i++)
        for (npy_intp j = 0; j < columns; j++) {
            corners_of(map, i, j, corners);
            const double square = squared_off(corners, low, high);
            if (square < least)
                least = square, first_row = i, first_column = j;
        }
    if (!(least < found->distance * found->distance))
        return 0;
    corners_of(map, first_row, first_column, corners);
    int nearer = look_at_cell(shape, corners, found);
    if (nearer < 0)
        return -1;
    double furthest[3];
    furthest_on_hull(shape, found->normal, furthest);
    double face = along(found->normal, furthest);
    for (npy_intp i = 0; i < rows; i++)
        for (npy_intp j = 0; j < columns; j++) {
            corners_of(map, i, j, corners);
            if (!(squared_off(corners, low, high) < found->distance * found->distance))
                continue;
            double lowest = INFINITY;
            for (int k = 0; k < 4; k++)
                lowest = fmin(lowest, along(found->normal, corners[k]));
            if (lowest - face >= found->distance)
                continue;
            const int more = look_at_cell(shape, corners, found);
            if (more < 0)
                return -1;
            if (more) {
                nearer = 1;
                furthest_on_hull(shape, found->normal, furthest);
                face = along(found->normal, furthest);
            }
        }
    return nearer;
}

PyObject *nearest_on_ground(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Map map;
    npy_intp shape[2];
    const double *hull;
    double radius, reach;
    if (count_is(count, 6, "nearest_on_ground") < 0 || !(hull = block(args[0], "hull", 2, shape)) ||
        has_length(shape[1], 3, "hull") < 0 || as_double(args[1], "radius", &radius) < 0 ||
        as_mat(args[2], "heights", -1, -1, &map.heights) < 0 ||
        as_vec(args[3], "x", map.heights.columns, &map.x) < 0 || as_vec(args[4], "y", map.heights.rows, &map.y) < 0 ||
        as_double(args[5], "reach", &reach) < 0)
        return NULL;
    if (shape[0] < 1)
        return PyTuple_New(0);
    Room room;
    double *points = room_for(&room, 3 * shape[0] * sizeof(double));
    if (!points)
        return NULL;
    memcpy(map.base, hull, sizeof(map.base));
    for (npy_intp k = 0; k < 3 * shape[0]; k++)
        points[k] = hull[k] - map.base[k % 3];
    const Hull own = {points, shape[0]};
    Nearest found = {reach + radius, {0.0, 0.0, -1.0}, {0.0}, {0.0}};
    const int nearer = look_at_map(&map, &own, &found);
    release(&room);
    if (nearer == 0)
        Py_RETURN_NONE;
    if (nearer < 0 || !(found.distance > radius))
        return PyTuple_New(0);
    double *to;
    PyObject *reading = new_vec(10, &to);
    if (!reading)
        return NULL;
    to[0] = found.distance - radius;
    for (int c = 0; c < 3; c++) {
        to[1 + c] = found.normal[c];
        to[4 + c] = found.on_shape[c] + radius * found.normal[c] + map.base[c];
        to[7 + c] = found.on_ground[c] + map.base[c];
    }
    return Py_BuildValue("(N)", reading);
}
