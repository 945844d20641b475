/* Gilbert, Johnson and Keerthi: the point of least norm in the differences of two convex bodies. */
#include "distance.h"

#include <math.h>
#include <string.h>

enum { MOST_ROUNDS = 64 };
static const double PRECISE = 1e-11; /* part of the distance by which the planes' gap may be less */
static const double TOUCHES = 1e-6;  /* m: closer than that the normal is not precise */

/* corners of a simplex: differences of points, the points, and the part that each has in the point of least norm */
typedef struct {
    double w[4][3], first[4][3], second[4][3], part[4];
    int count;
} Simplex;

static double dot(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void minus(const double *a, const double *b, double *out)
{
    for (int c = 0; c < 3; c++)
        out[c] = a[c] - b[c];
}

static void cross(const double *a, const double *b, double *out)
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

static const double *furthest(const Hull *hull, const double *n)
{
    const double *best = hull->points;
    double most = -INFINITY;
    for (ptrdiff_t k = 0; k < hull->count; k++) {
        const double along = dot(hull->points + 3 * k, n);
        if (along > most)
            most = along, best = hull->points + 3 * k;
    }
    return best;
}

void furthest_on_hull(const void *hull, const double *direction, double *point)
{
    memcpy(point, furthest(hull, direction), 3 * sizeof(double));
}

/* the parts of the corners a, b in the point of their segment that is nearest to the origin */
static void on_segment(const double *a, const double *b, double *part)
{
    double way[3];
    minus(b, a, way);
    const double size = dot(way, way), along = size > 0.0 ? -dot(a, way) / size : 0.0;
    part[1] = along < 0.0 ? 0.0 : along > 1.0 ? 1.0 : along;
    part[0] = 1.0 - part[1];
}

/* the same of the corners a, b, c of a triangle: by the regions in which the origin can lie */
static void on_triangle(const double *a, const double *b, const double *c, double *part)
{
    double ab[3], ac[3];
    minus(b, a, ab), minus(c, a, ac);
    const double d1 = -dot(ab, a), d2 = -dot(ac, a), d3 = -dot(ab, b), d4 = -dot(ac, b), d5 = -dot(ab, c), d6 = -dot(ac, c);
    const double vc = d1 * d4 - d3 * d2, vb = d5 * d2 - d1 * d6, va = d3 * d6 - d5 * d4;
    part[0] = part[1] = part[2] = 0.0;
    if (d1 <= 0.0 && d2 <= 0.0)
        part[0] = 1.0;
    else if (d3 >= 0.0 && d4 <= d3)
        part[1] = 1.0;
    else if (d6 >= 0.0 && d5 <= d6)
        part[2] = 1.0;
    else if (vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0)
        part[1] = d1 / (d1 - d3), part[0] = 1.0 - part[1];
    else if (vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0)
        part[2] = d2 / (d2 - d6), part[0] = 1.0 - part[2];
    else if (va <= 0.0 && d4 >= d3 && d5 >= d6)
        part[2] = (d4 - d3) / (d4 - d3 + d5 - d6), part[1] = 1.0 - part[2];
    else {
        const double sum = va + vb + vc;
        part[1] = vb / sum, part[2] = vc / sum, part[0] = 1.0 - part[1] - part[2];
    }
}

/* the point of a simplex with these parts */
static void blend(const Simplex *simplex, const double (*points)[3], double *out)
{
    out[0] = out[1] = out[2] = 0.0;
    for (int k = 0; k < simplex->count; k++)
        for (int c = 0; c < 3; c++)
            out[c] += simplex->part[k] * points[k][c];
}

/* Find the parts of the point of a tetrahedron nearest to the origin. 0, or -1 where the origin is inside. */
static int on_tetrahedron(Simplex *simplex)
{
    static const int faces[4][4] = {{0, 1, 2, 3}, {0, 1, 3, 2}, {0, 2, 3, 1}, {1, 2, 3, 0}};
    double best[4], least = INFINITY;
    for (int f = 0; f < 4; f++) {
        const double *a = simplex->w[faces[f][0]], *b = simplex->w[faces[f][1]], *c = simplex->w[faces[f][2]];
        double ab[3], ac[3], ad[3], n[3], part[3], point[3];
        minus(b, a, ab), minus(c, a, ac), minus(simplex->w[faces[f][3]], a, ad);
        cross(ab, ac, n);
        const double side = dot(n, ad), flat = 1e-12 * sqrt(dot(n, n) * dot(ad, ad));
        if (fabs(side) > flat && -dot(n, a) * side > 0.0)
            continue; /* the origin is on the side of the other corner */
        on_triangle(a, b, c, part);
        for (int i = 0; i < 3; i++)
            point[i] = part[0] * a[i] + part[1] * b[i] + part[2] * c[i];
        const double size = dot(point, point);
        if (size < least) {
            least = size;
            memset(best, 0, sizeof(best));
            for (int i = 0; i < 3; i++)
                best[faces[f][i]] = part[i];
        }
    }
    if (!(least < INFINITY))
        return -1;
    memcpy(simplex->part, best, sizeof(best));
    return 0;
}

/* Let a simplex be its smallest one with the point nearest to the origin in it. 0, or -1 where the origin is inside. */
static int reduce(Simplex *simplex)
{
    simplex->part[0] = 1.0;
    if (simplex->count == 2)
        on_segment(simplex->w[0], simplex->w[1], simplex->part);
    else if (simplex->count == 3)
        on_triangle(simplex->w[0], simplex->w[1], simplex->w[2], simplex->part);
    else if (simplex->count == 4 && on_tetrahedron(simplex) < 0)
        return -1;
    int kept = 0;
    for (int k = 0; k < simplex->count; k++)
        if (simplex->part[k] > 0.0) {
            memmove(simplex->w[kept], simplex->w[k], sizeof(simplex->w[k]));
            memmove(simplex->first[kept], simplex->first[k], sizeof(simplex->w[k]));
            memmove(simplex->second[kept], simplex->second[k], sizeof(simplex->w[k]));
            simplex->part[kept++] = simplex->part[k];
        }
    simplex->count = kept;
    return kept ? 0 : -1;
}

/* Take the difference of two points into a simplex; `v` becomes its point nearest to the origin. 0, or -1 where the
 * origin is inside. */
static int grow(Simplex *simplex, const double *a, const double *b, double *v)
{
    if (simplex->count == 4)
        return -1;
    minus(b, a, simplex->w[simplex->count]);
    memcpy(simplex->first[simplex->count], a, sizeof(simplex->first[0]));
    memcpy(simplex->second[simplex->count++], b, sizeof(simplex->second[0]));
    if (reduce(simplex) < 0)
        return -1;
    blend(simplex, simplex->w, v);
    return 0;
}

int distance_within(Support furthest_on, const void *first, const void *second, double reach, double *normal,
                    double *distance, double *on_first, double *on_second)
{
    Simplex simplex = {.count = 0};
    double v[3] = {normal[0], normal[1], normal[2]};
    if (!(dot(v, v) > TOUCHES * TOUCHES))
        v[0] = 1.0, v[1] = v[2] = 0.0;
    for (int round = 0; round < MOST_ROUNDS; round++) {
        const double back[3] = {-v[0], -v[1], -v[2]}, size = dot(v, v), length = sqrt(size);
        double a[3], b[3], w[3];
        if (!(size > TOUCHES * TOUCHES))
            return -1;
        furthest_on(first, v, a), furthest_on(second, back, b);
        minus(b, a, w);
        const double along = dot(v, w);
        const int is_apart = along >= reach * length;
        if (is_apart || (simplex.count && size - along <= PRECISE * size)) {
            for (int c = 0; c < 3; c++)
                normal[c] = v[c] / length;
            *distance = dot(normal, w);
            if (!is_apart)
                blend(&simplex, simplex.first, on_first), blend(&simplex, simplex.second, on_second);
            return !is_apart;
        }
        if (grow(&simplex, a, b, v) < 0)
            return -1;
    }
    return -1;
}

int hull_distance(const Hull *first, const Hull *second, double *distance, double *normal, double *on_first,
                  double *on_second)
{
    minus(second->points, first->points, normal);
    const int found =
        distance_within(furthest_on_hull, first, second, INFINITY, normal, distance, on_first, on_second);
    return found > 0 ? 0 : -1;
}

int come_nearer(Support furthest_on, const void *first, const void *second, double reach, double *normal)
{
    Simplex simplex = {.count = 0};
    double v[3] = {normal[0], normal[1], normal[2]};
    if (!(dot(v, v) > TOUCHES * TOUCHES))
        v[0] = 1.0, v[1] = v[2] = 0.0;
    for (int round = 0; round < MOST_ROUNDS; round++) {
        const double back[3] = {-v[0], -v[1], -v[2]}, length = sqrt(dot(v, v));
        double a[3], b[3], w[3];
        if (!(length > TOUCHES))
            return reach > TOUCHES ? 1 : -1;
        furthest_on(first, v, a), furthest_on(second, back, b);
        minus(b, a, w);
        const double gap = dot(v, w) / length;
        if (gap >= reach) {
            for (int c = 0; c < 3; c++)
                normal[c] = v[c] / length;
            return 0;
        }
        if (simplex.count && length - gap <= PRECISE * length)
            return length < reach ? 1 : -1;
        if (grow(&simplex, a, b, v) < 0)
            return reach > 0.0 ? 1 : -1;
        if (dot(v, v) < reach * fabs(reach))
            return 1;
    }
    return -1;
}
