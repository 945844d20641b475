/* The distance between two convex bodies that do not touch. */
#ifndef BACKHOE_DISTANCE
#define BACKHOE_DISTANCE
#include <stddef.h>

/* the convex hull of points (count, 3), row after row */
typedef struct {
    const double *points;
    ptrdiff_t count;
} Hull;

/* How far two hulls are apart, between which points, and the unit normal from the first to the second. The distance is
 * what two planes across the normal leave between them, so never more than the true one; it is less by 1e-11 of it at
 * most. 0, or -1 where they touch or that is not reached. */
int hull_distance(const Hull *first, const Hull *second, double *distance, double *normal, double *on_first,
                  double *on_second);

#endif
