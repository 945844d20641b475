/* How near a convex shape is to the surface of a height map: machine/clusters/terrain.py. */
#include "arrays.h"
#include "asked.h"
#include "distance.h"
#include "place.h"
#include "rings.h"

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

/* The square of how far the column under a cell's highest corner is from the box around the shape. */
static double squared_off(const double (*corners)[3], const double *low, const double *high)
{
    const double aside = gap_between(low[0], high[0], corners[0][0], corners[3][0]);
    const double beside = gap_between(low[1], high[1], corners[0][1], corners[3][1]);
    const double top = fmax(fmax(corners[0][2], corners[1][2]), fmax(corners[2][2], corners[3][2]));
    const double above = fmax(low[2] - top, 0.0);
    return aside * aside + beside * beside + above * above;
}

/* The corners of one of the two triangles of a cell, which meet along its higher diagonal. */
static void triangle_of(const double (*corners)[3], int triangle, double *points)
{
    const int main = corners[0][2] + corners[3][2] >= corners[1][2] + corners[2][2];
    const int ends[2][3] = {{0, 1, main ? 3 : 2}, {main ? 0 : 1, 3, 2}};
    for (int k = 0; k < 3; k++)
        memcpy(points + 3 * k, corners[ends[triangle][k]], sizeof(corners[0]));
}

/* Look at the two triangles of a cell for what is nearer than `found`: 1 where something is, 0, or -1 undecided. */
static int look_at_cell(const Hull *shape, const double (*corners)[3], Place *found)
{
    int nearer = 0;
    for (int triangle = 0; triangle < 2; triangle++) {
        double points[9], guess[3];
        triangle_of(corners, triangle, points);
        const Hull other = {points, 3};
        memcpy(guess, found->normal, sizeof(guess));
        if (come_nearer(furthest_on_hull, shape, &other, found->distance, guess) == 0)
            continue;
        Place here;
        if (hull_distance(shape, &other, &here.distance, here.normal, here.on_shape, here.on_other) < 0)
            return -1;
        if (here.distance < found->distance)
            *found = here, nearer = 1;
    }
    return nearer;
}

/* Look at all cells, first at the one that may be nearest; as `look_at_cell`. */
static int look_at_map(const Map *map, const Hull *shape, Place *found)
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
    Hull shape;
    double radius, reach;
    if (count_is(count, 6, "nearest_on_ground") < 0 || as_shape(args[0], args[1], &shape, &radius) < 0 ||
        as_mat(args[2], "heights", -1, -1, &map.heights) < 0 ||
        as_vec(args[3], "x", map.heights.columns, &map.x) < 0 || as_vec(args[4], "y", map.heights.rows, &map.y) < 0 ||
        as_double(args[5], "reach", &reach) < 0)
        return NULL;
    if (shape.count < 1)
        return PyTuple_New(0);
    Room room;
    double *points = room_for(&room, 3 * shape.count * sizeof(double));
    if (!points)
        return NULL;
    memcpy(map.base, shape.points, sizeof(map.base));
    for (npy_intp k = 0; k < 3 * shape.count; k++)
        points[k] = shape.points[k] - map.base[k % 3];
    const Hull own = {points, shape.count};
    Place found = {reach + radius, {0.0, 0.0, -1.0}, {0.0}, {0.0}};
    const int nearer = look_at_map(&map, &own, &found);
    release(&room);
    return answer_of_place(nearer, &found, radius, map.base);
}

/* a whole height map in its own frame, and where that is in the world; see `kept_over_ground` */
typedef struct {
    Mat heights;
    Vec x, y;
    const double *R, *t; /* row by row */
    double floor, top;
} Ground;

/* How high the ground is at a point, and how much it rises along x and y; minus infinity beside the map. */
static double height_at(const Ground *g, const double *point, double *rise)
{
    const npy_intp columns = g->x.n - 1, rows = g->y.n - 1;
    const double wide = AT(g->x, 1) - AT(g->x, 0), deep = AT(g->y, 1) - AT(g->y, 0);
    const double across = (point[0] - AT(g->x, 0)) / wide, up = (point[1] - AT(g->y, 0)) / deep;
    if (!(across >= 0.0 && across < (double)columns && up >= 0.0 && up < (double)rows))
        return -INFINITY;
    const npy_intp j = (npy_intp)across, i = (npy_intp)up;
    const double u = across - (double)j, v = up - (double)i;
    const double a = AT2(g->heights, i, j), b = AT2(g->heights, i, j + 1), c = AT2(g->heights, i + 1, j),
                 d = AT2(g->heights, i + 1, j + 1);
    const int main = a + d >= b + c; /* cut along a d, else along b c */
    const double first = main ? a + u * (b - a) + v * (d - b) : a + u * (b - a) + v * (c - a);
    const double second = main ? a + v * (c - a) + u * (d - c) : d + (1.0 - u) * (c - d) + (1.0 - v) * (b - d);
    const int is_first = first <= second;
    rise[0] = (is_first ? b - a : d - c) / wide;
    rise[1] = (is_first == main ? d - b : c - a) / deep;
    return is_first ? first : second;
}

/* Whether a shape is `reach` off all triangles of some cells: 1 or 0, -1 where that is not decided. */
static int off_cells(const Map *map, const Hull *shape, const double *low, const double *high, double reach)
{
    double corners[4][3], normal[3] = {0.0, 0.0, -1.0}, furthest[3];
    int kept = 1;
    furthest_on_hull(shape, normal, furthest);
    for (npy_intp i = 0; i < map->heights.rows - 1; i++)
        for (npy_intp j = 0; j < map->heights.columns - 1; j++) {
            corners_of(map, i, j, corners);
            double lowest = INFINITY;
            for (int k = 0; k < 4; k++)
                lowest = fmin(lowest, along(normal, corners[k]));
            if (lowest - along(normal, furthest) >= reach || squared_off(corners, low, high) >= reach * reach)
                continue;
            for (int triangle = 0; triangle < 2; triangle++) {
                double points[9], guess[3];
                triangle_of(corners, triangle, points);
                const Hull other = {points, 3};
                memcpy(guess, normal, sizeof(guess));
                const int nearer = come_nearer(furthest_on_hull, shape, &other, reach, guess);
                if (nearer > 0)
                    return 0;
                if (nearer < 0)
                    kept = -1;
                else {
                    memcpy(normal, guess, sizeof(normal));
                    furthest_on_hull(shape, normal, furthest);
                }
            }
        }
    return kept;
}

/* The corner that is least above the ground, straight up. */
typedef struct {
    double above, rise[2];
    npy_intp which;
    int is_finite; /* all corners are */
} Lowest;

/* The lowest corner of a shape, infinitely high where none is over the ground; the box around all in `low`, `high`. */
static Lowest lowest_corner(const Ground *g, const double *points, npy_intp count, double *low, double *high)
{
    Lowest lowest = {INFINITY, {0.0, 0.0}, 0, 1};
    for (int c = 0; c < 3; c++)
        low[c] = INFINITY, high[c] = -INFINITY;
    for (npy_intp k = 0; k < count; k++) {
        const double *point = points + 3 * k;
        double rise[2] = {0.0, 0.0};
        const double above = point[2] - height_at(g, point, rise);
        if (point[2] >= g->floor && above < lowest.above)
            lowest = (Lowest){above, {rise[0], rise[1]}, k, lowest.is_finite};
        lowest.is_finite = lowest.is_finite && isfinite(point[0]) && isfinite(point[1]) && isfinite(point[2]);
        for (int c = 0; c < 3; c++)
            low[c] = fmin(low[c], point[c]), high[c] = fmax(high[c], point[c]);
    }
    return lowest;
}

/* How deep the lowest corner of a shape is under the plane of the ground above it. */
static void read_sunk(const Ground *g, const double *corner, double radius, const Lowest *lowest, double *to)
{
    const double steep = sqrt(1.0 + lowest->rise[0] * lowest->rise[0] + lowest->rise[1] * lowest->rise[1]);
    const double normal[3] = {lowest->rise[0] / steep, lowest->rise[1] / steep, -1.0 / steep};
    const double distance = lowest->above / steep - radius;
    double own[9];
    for (int c = 0; c < 3; c++) {
        own[c] = normal[c];
        own[3 + c] = corner[c] + radius * normal[c];
        own[6 + c] = own[3 + c] + distance * normal[c];
    }
    put_reading(g->R, g->t, distance, own, to);
}

/* The number of a cell, among `count`. */
static npy_intp cell_among(double at, npy_intp count)
{
    return at > 0.0 ? (npy_intp)fmin(at, (double)(count - 1)) : 0;
}

/* The cells within `reach` of a box, and the shape's points from the first of them: 0 where walls or floor are as near. */
static int cells_around(const Ground *g, double *points, npy_intp count, double *low, double *high, double reach,
                        Map *map)
{
    const npy_intp columns = g->x.n - 1, rows = g->y.n - 1;
    const double left = AT(g->x, 0), front = AT(g->y, 0);
    if (low[0] - left < reach || AT(g->x, columns) - high[0] < reach || low[1] - front < reach ||
        AT(g->y, rows) - high[1] < reach || low[2] - g->floor < reach)
        return 0;
    const double wide = AT(g->x, 1) - left, deep = AT(g->y, 1) - front;
    if (!(wide > 0.0 && deep > 0.0)) /* no even distances */
        return 0;
    const npy_intp j = cell_among((low[0] - reach - left) / wide, columns);
    const npy_intp i = cell_among((low[1] - reach - front) / deep, rows);
    const npy_intp last_j = cell_among((high[0] + reach - left) / wide, columns);
    const npy_intp last_i = cell_among((high[1] + reach - front) / deep, rows);
    *map = (Map){g->heights, g->x, g->y, {points[0], points[1], points[2]}};
    map->heights.data = (char *)&AT2(g->heights, i, j), map->x.data = (char *)&AT(g->x, j);
    map->y.data = (char *)&AT(g->y, i);
    map->heights.rows = last_i - i + 2, map->heights.columns = last_j - j + 2;
    for (npy_intp k = 0; k < 3 * count; k++)
        points[k] -= map->base[k % 3];
    for (int c = 0; c < 3; c++)
        low[c] -= map->base[c], high[c] -= map->base[c];
    return 1;
}

/* Whether a shape with `count` corners, within `radius` of whose hull it is, is at least `least` above the ground. */
static int kept_by_shape(const Ground *g, double *points, npy_intp count, double radius, double least)
{
    double low[3], high[3];
    const double reach = radius + least;
    const Lowest lowest = lowest_corner(g, points, count, low, high);
    const double above = lowest.above;
    Map map;
    if (!lowest.is_finite || !isfinite(reach))
        return -1;
    if (above > 0.0 ? above < reach : least > 0.0)
        return 0;
    if (low[2] - g->top >= reach)
        return 1;
    if (!(least > 0.0) || !cells_around(g, points, count, low, high, reach, &map))
        return -1;
    const Hull shape = {points, count};
    return off_cells(&map, &shape, low, high, reach);
}

/* How far it is from the ground within a reach: 1, 0 where it is not less, 2 for the depth of a corner, -1 undecided. */
static int read_shape(const Ground *g, double *points, npy_intp count, double radius, double within, double *to)
{
    double low[3], high[3];
    const double reach = radius + within;
    const Lowest lowest = lowest_corner(g, points, count, low, high);
    Map map;
    if (!lowest.is_finite || !isfinite(reach))
        return -1;
    if (lowest.above <= 0.0) {
        read_sunk(g, points + 3 * lowest.which, radius, &lowest, to);
        return 2;
    }
    if (low[2] - g->top >= reach)
        return 0;
    if (!(within > 0.0) || !cells_around(g, points, count, low, high, reach, &map))
        return -1;
    const Hull shape = {points, count};
    Place found = {reach, {0.0, 0.0, -1.0}, {0.0}, {0.0}};
    const int nearer = look_at_map(&map, &shape, &found);
    if (nearer <= 0)
        return nearer;
    if (!(found.distance > radius))
        return -1;
    double own[9];
    vectors_of(&found, radius, map.base, own);
    put_reading(g->R, g->t, found.distance - radius, own, to);
    return 1;
}

/* What is asked of some pieces over ground */
typedef struct {
    Asked asked;
    Ground ground;
} Question;

/* The arguments of `read_over_ground`; 0, or -1 with an exception. */
static int read_question(PyObject *const *args, Question *q)
{
    Ground *g = &q->ground;
    double levels[2];
    args += OF_ASKED;
    if (read_asked(args - OF_ASKED, &q->asked) < 0 || as_mat(args[0], "heights", -1, -1, &g->heights) < 0 ||
        as_vec(args[1], "x", g->heights.columns, &g->x) < 0 || as_vec(args[2], "y", g->heights.rows, &g->y) < 0 ||
        as_doubles(args[3], "levels", 2, levels) < 0)
        return -1;
    g->R = q->asked.frame, g->t = q->asked.origin, g->floor = levels[0], g->top = levels[1];
    return 0;
}

/* Put the corners of what question k is about into `points`; how many, 0 where there is no answer to it. */
static npy_intp corners_over(const Question *q, npy_intp k, double *points)
{
    return q->ground.x.n < 2 || q->ground.y.n < 2 ? 0 : corners_asked(&q->asked, k, points);
}

/* what is asked, with balls around the pieces and the heights around the balls */
typedef struct {
    Question question;
    Rings rings;
    Balls balls;
} Judged;

/* Whether balls around a piece show that it is as far from the ground as question k says. */
static int kept_by_balls(const Judged *judged, npy_intp k)
{
    const Asked *asked = &judged->question.asked;
    const Balls *balls = &judged->balls;
    const npy_intp piece = INDEX(asked->piece, k);
    for (npy_intp i = INDEX(balls->starts, piece); i < INDEX(balls->starts, piece + 1); i++) {
        double centre[3];
        place_asked(asked, k, balls->ball + 4 * i, centre);
        const double apart = lower_by_rings(&judged->rings, centre) - balls->ball[4 * i + 3];
        if (!isfinite(apart) || !(apart > 0.0 && apart >= AT(asked->number, k))) /* where a ball may touch, nothing is known */
            return 0;
    }
    return 1;
}

static int judge_over_ground(const void *around, npy_intp k, double *points)
{
    const Judged *judged = around;
    const Question *q = &judged->question;
    if (kept_by_balls(judged, k))
        return 1;
    const npy_intp corners = corners_over(q, k, points);
    const double radius = q->asked.radius[INDEX(q->asked.piece, k)];
    return corners ? kept_by_shape(&q->ground, points, corners, radius, AT(q->asked.number, k)) : -1;
}

PyObject *kept_over_ground(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Judged judged;
    if (count_is(count, 24, "kept_over_ground") < 0 || read_question(args, &judged.question) < 0 ||
        read_balls(args + 15, &judged.question.asked, &judged.balls) < 0 || read_rings(args + 17, &judged.rings) < 0)
        return NULL;
    return verdicts_on(&judged.question.asked, judge_over_ground, &judged);
}

static int read_in_ground(const void *around, npy_intp k, double *points, double *to)
{
    const Question *q = around;
    const npy_intp corners = corners_over(q, k, points);
    const double radius = q->asked.radius[INDEX(q->asked.piece, k)];
    return corners ? read_shape(&q->ground, points, corners, radius, AT(q->asked.number, k), to) : -1;
}

PyObject *read_over_ground(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Question q;
    if (count_is(count, 15, "read_over_ground") < 0 || read_question(args, &q) < 0)
        return NULL;
    return readings_of(&q.asked, read_in_ground, &q);
}
