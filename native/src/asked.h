/* What is asked of pieces of a machine in some configurations, each with a number: site/pairs/link_corners.py. */
#ifndef BACKHOE_ASKED
#define BACKHOE_ASKED
#include "arrays.h"

/* Question k is about piece `piece` k in configuration `row` k. Pose j of configuration i is R + 9 (joints i + j), and t
 * likewise; the corners of the pieces stand one after the other. */
typedef struct {
    const double *R, *t, *corner, *radius;
    Ind slot, starts;
    npy_intp joints, most;        /* most: corners of a piece */
    const double *frame, *origin; /* of what is around, in the world; row by row */
    Ind row, piece;
    Vec number;
} Asked;

/* balls (S, 4) that cover the pieces, one after the other */
typedef struct {
    const double *ball;
    Ind starts;
} Balls;

enum { OF_ASKED = 11, OF_BALLS = 2 };
/* the first eleven arguments of `kept_over_ground`, and two that are balls; 0, or -1 with an exception */
int read_asked(PyObject *const *args, Asked *asked);
int read_balls(PyObject *const *args, const Asked *asked, Balls *balls);
/* A point of the piece of question k in the frame of what is around. */
void place_asked(const Asked *asked, npy_intp k, const double *own, double *point);
/* Put the corners of that piece there into `points`; how many. */
npy_intp corners_asked(const Asked *asked, npy_intp k, double *points);

#endif
