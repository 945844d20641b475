/* The distance between two convex bodies that do not touch, and whether two come nearer than a distance. */
#ifndef BACKHOE_DISTANCE
#define BACKHOE_DISTANCE
#include <stddef.h>

/* the convex hull of points (count, 3), row after row */
typedef struct {
    const double *points;
    ptrdiff_t count;
} Hull;

/* the point of a body that is furthest along a direction */
typedef void (*Support)(const void *body, const double *direction, double *point);
void furthest_on_hull(const void *hull, const double *direction, double *point); /* of a `Hull` */

/* How far two bodies are apart, between which points, and the unit normal from the first to the second, which begins as a
 * guess. The distance is what two planes across the normal leave between them, so never more than the true one; it is less
 * by 1e-11 of it at most. 1 with these; 0 where planes leave `reach` or more between them, with that distance and normal but
 * no points; -1 where they touch or that is not reached. */
int distance_within(Support furthest_on, const void *first, const void *second, double reach, double *normal,
                    double *distance, double *on_first, double *on_second);

/* The same of two hulls without a guess, however far they are apart. 0, or -1 where they touch or that is not reached. */
int hull_distance(const Hull *first, const Hull *second, double *distance, double *normal, double *on_first,
                  double *on_second);

/* Whether two bodies come nearer than `reach`: 1 where they do, 0 where a plane across `normal` (from the first to the
 * second, which begins as a guess) proves that they do not, -1 where it is not decided: where the
 * distance is `reach` but for rounding, and where they touch or overlap and `reach` is not above 0. */
int come_nearer(Support furthest_on, const void *first, const void *second, double reach, double *normal);

#endif
