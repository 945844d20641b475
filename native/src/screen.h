/* A machine among bodies, as `first_not_apart` takes them, and what is known of pairs of their pieces. */
#ifndef BACKHOE_SCREEN
#define BACKHOE_SCREEN
#include "arrays.h"
#include "distance.h"

/* what is known of a pair */
typedef enum { APART, NEARER, UNDECIDED } Verdict;

/* R row by row, then t: T_world_joint */
typedef struct {
    double R[9], t[3];
} Pose;

/* Some corners, and the frame that they are in */
typedef struct {
    const double *x, *y, *z;
    npy_intp count;
    double radius;
    const Pose *pose;
} Corners;

/* What a screen is made of; see `first_not_apart`. */
typedef struct {
    Mat q, factors, normals;
    Vec slides, least;
    Ind joint, starts, corner_starts, first, second;
    npy_intp own, every, corners, balls;
    const double *coarse, *fine, *corner, *radius, *box;
} Screen;

/* A configuration of the machine with its balls. */
typedef struct {
    double factors[MOST_JOINTS][33], slides[MOST_JOINTS];
    Pose pose[MOST_JOINTS + 1];
    double (*centre)[3], (*ball)[3];
    Room room;
} Machine;

/* The first fifteen arguments of `first_not_apart`, and a machine of them; 0, or -1 with an exception. */
int read_screen(PyObject *const *args, Screen *s);
int machine_of(const Screen *s, Machine *m);
void place_at(const Screen *s, Machine *m, npy_intp row); /* where it stands in a row of q */
void moved(const Pose *pose, const double *x, double *into);
Corners corners_of(const Screen *s, npy_intp piece, const Pose *pose);
void furthest_corner(const void *of, const double *n, double *point);
/* As `distance_within` for a pair, with the radii of its pieces, from the normal that was found last, which is kept in the
 * frame of the second. */
int distance_from_kept(const Screen *s, npy_intp pair, const Pose *pose, double reach, double *distance, double *normal,
                       double *point);
double balls_apart(const Screen *s, npy_intp a, npy_intp b, const double (*ball)[3], const double *rounder);

#endif
