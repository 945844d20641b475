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

/* Ten numbers in the world of a reading in the frame R, t of what is around: a distance, and three vectors. */
void put_reading(const double *R, const double *t, double distance, const double *own, double *to);

/* Whether the piece of question k keeps the distance `number`: 1, 0, or -1 unknown. `points` has room for its corners. */
typedef int (*Judge)(const void *around, npy_intp k, double *points);
/* (M,) the verdicts on all questions. After a piece that is nearer, the others of its configuration are unknown. */
PyObject *verdicts_on(const Asked *asked, Judge judge, const void *around);
/* The distance in question k: 1 and its (10,) numbers in `to`, 0 where it is not less than `number`, -1 unknown. */
typedef int (*Read)(const void *around, npy_intp k, double *points, double *to);
/* (M,) the states of all questions, and (M, 10) their numbers, 0 where none are read. */
PyObject *readings_of(const Asked *asked, Read read, const void *around);

#endif
