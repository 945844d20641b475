/* How near a convex shape is to the triangles of a mesh: machine/clusters/triangle_tree.py. */
#include "arrays.h"
#include "distance.h"
#include "place.h"
#include "rings.h"

#include <math.h>
#include <string.h>

enum { DEEPEST = 64 }; /* levels of a tree, far more than any mesh has */

/* node k of the tree has the children 2 k and 2 k + 1; the last half of the nodes are its leaves */
typedef struct {
    const double *boxes, *corners; /* (nodes, 6) lowest and highest corner; (triangles, 9) */
    npy_intp nodes, triangles, in_leaf;
} Mesh;

/* the shape, the box around it, and the nearest place found so far */
typedef struct {
    Hull shape;
    double low[3], high[3];
    Place place;
    double across[3], face; /* the normal of a plane beside the shape, and how far that extends along it */
} Nearest;

static double along(const double *n, const double *x)
{
    return n[0] * x[0] + n[1] * x[1] + n[2] * x[2];
}

static void take_plane(Nearest *found, const double *normal)
{
    double furthest[3];
    memcpy(found->across, normal, sizeof(found->across));
    furthest_on_hull(&found->shape, normal, furthest);
    found->face = along(normal, furthest);
}

/* How far the boxes around a node and around the shape are apart. */
static double box_gap(const double *box, const Nearest *found)
{
    double square = 0.0;
    for (int c = 0; c < 3; c++) {
        const double gap = gap_between(found->low[c], found->high[c], box[c], box[3 + c]);
        square += gap * gap;
    }
    return sqrt(square);
}

/* Whether the box of a node is beyond the plane by as much as what was found. */
static int is_beyond(const double *box, const Nearest *found)
{
    double nearest = -found->face;
    for (int c = 0; c < 3; c++)
        nearest += found->across[c] * (found->across[c] > 0.0 ? box[c] : box[3 + c]);
    return nearest >= found->place.distance;
}

/* Look at the triangles of a leaf for what is nearer than `found`: 1 where something is, 0, or -1 undecided. */
static int look_at_leaf(const Mesh *mesh, npy_intp leaf, Nearest *found)
{
    const npy_intp begin = leaf * mesh->in_leaf, end = begin + mesh->in_leaf;
    int nearer = 0;
    for (npy_intp k = begin; k < end && k < mesh->triangles; k++) {
        const double *points = mesh->corners + 9 * k;
        double least = INFINITY, guess[3], distance, normal[3], on_shape[3], on_mesh[3];
        for (int corner = 0; corner < 3; corner++)
            least = fmin(least, along(found->across, points + 3 * corner));
        if (least - found->face >= found->place.distance)
            continue;
        const Hull other = {points, 3};
        memcpy(guess, found->across, sizeof(guess));
        if (come_nearer(furthest_on_hull, &found->shape, &other, found->place.distance, guess) == 0) {
            take_plane(found, guess);
            continue;
        }
        if (hull_distance(&found->shape, &other, &distance, normal, on_shape, on_mesh) < 0)
            return -1;
        if (distance < found->place.distance) {
            found->place.distance = distance, nearer = 1;
            take_plane(found, normal);
            memcpy(found->place.normal, normal, sizeof(normal));
            memcpy(found->place.on_shape, on_shape, sizeof(on_shape));
            memcpy(found->place.on_other, on_mesh, sizeof(on_mesh));
        }
    }
    return nearer;
}

/* Look at all triangles, nearer nodes first; as `look_at_leaf`. */
static int look_at_mesh(const Mesh *mesh, Nearest *found)
{
    const npy_intp leaves = mesh->nodes / 2;
    npy_intp open[DEEPEST] = {1};
    double gaps[DEEPEST] = {box_gap(mesh->boxes + 6, found)};
    int count = 1, nearer = 0;
    while (count) {
        const npy_intp node = open[--count];
        if (gaps[count] >= found->place.distance || is_beyond(mesh->boxes + 6 * node, found))
            continue;
        if (node >= leaves) {
            const int more = look_at_leaf(mesh, node - leaves, found);
            if (more < 0)
                return -1;
            nearer |= more;
            continue;
        }
        const npy_intp first = 2 * node;
        const double gap[2] = {box_gap(mesh->boxes + 6 * first, found), box_gap(mesh->boxes + 6 * (first + 1), found)};
        const int near = gap[1] < gap[0]; /* the nearer one is looked at first, so it is put last */
        for (int k = 0; k < 2; k++) {
            const int which = k ? near : !near;
            if (gap[which] < found->place.distance)
                open[count] = first + which, gaps[count++] = gap[which];
        }
    }
    return nearer;
}

PyObject *nearest_on_mesh(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Mesh mesh;
    npy_intp boxes[2], corners[2];
    Hull shape;
    double radius, reach;
    if (count_is(count, 6, "nearest_on_mesh") < 0 || as_shape(args[0], args[1], &shape, &radius) < 0 ||
        !(mesh.boxes = block(args[2], "boxes", 2, boxes)) || has_length(boxes[1], 6, "boxes") < 0 ||
        !(mesh.corners = block(args[3], "corners", 2, corners)) || has_length(corners[1], 9, "corners") < 0 ||
        as_double(args[5], "reach", &reach) < 0)
        return NULL;
    mesh.nodes = boxes[0], mesh.triangles = corners[0], mesh.in_leaf = PyLong_AsSsize_t(args[4]);
    if (mesh.in_leaf == -1 && PyErr_Occurred())
        return NULL;
    if (shape.count < 1 || mesh.nodes < 2 || mesh.in_leaf < 1 || mesh.in_leaf * (mesh.nodes / 2) < mesh.triangles)
        return PyTuple_New(0);
    Nearest found = {.shape = shape, .place.distance = reach + radius};
    for (int c = 0; c < 3; c++) {
        found.low[c] = INFINITY, found.high[c] = -INFINITY;
        for (npy_intp k = 0; k < shape.count; k++) {
            found.low[c] = fmin(found.low[c], shape.points[3 * k + c]);
            found.high[c] = fmax(found.high[c], shape.points[3 * k + c]);
        }
    }
    take_plane(&found, (double[]){0.0, 0.0, -1.0});
    return answer_of_place(look_at_mesh(&mesh, &found), &found.place, radius, (double[]){0.0, 0.0, 0.0});
}
