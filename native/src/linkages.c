/* Moment arms of cylinders: machine/hydraulics/linkage.py, where the formulas stand, and linkage_arms.py. */
#include "arrays.h"

#include <math.h>

#define COLUMNS 11

static const double ROUNDING = 1e-9; /* of a cosine; as of the plain version */

typedef struct {
    double a, b, phi0, offset, x, y, rocker, link, pin, pin_angle, side;
} Linkage;

/* Of a cylinder across its joint, at an angle: dl/dq and its slope. */
static double arm_of(const Linkage *of, double angle, double *slope)
{
    const double half = sin(0.5 * (angle + of->phi0)), off = of->a - of->b;
    const double length = sqrt(off * off + of->offset * of->offset + 4.0 * of->a * of->b * half * half);
    const double arm = of->a * of->b * sin(angle + of->phi0) / length;
    *slope = (of->a * of->b * cos(angle + of->phi0) - arm * arm) / length;
    return arm;
}

/* The inner product of (ax, ay) and a quarter turn of (bx, by). */
static double turn(double ax, double ay, double bx, double by)
{
    return ax * -by + ay * bx;
}

/* The same of one that turns a rocker. */
static double arm_over_rocker(const Linkage *of, double angle, double *slope)
{
    const double Bx = of->pin * cos(angle + of->pin_angle), By = of->pin * sin(angle + of->pin_angle);
    const double dx = Bx - of->x, dy = By - of->y, d = hypot(dx, dy);
    double cosine = (of->rocker * of->rocker + d * d - of->link * of->link) / (2.0 * of->rocker * d);
    if (!(fabs(cosine) <= 1.0 + ROUNDING))
        cosine = NAN; /* the four-bar does not close */
    cosine = cosine > 1.0 ? 1.0 : cosine < -1.0 ? -1.0 : cosine;
    const double theta = atan2(dy, dx) + of->side * acos(cosine);
    const double Rx = of->rocker * cos(theta), Ry = of->rocker * sin(theta); /* from the rocker's pivot */
    const double lx = Rx - dx, ly = Ry - dy;
    const double over = turn(lx, ly, Bx, By), under = turn(lx, ly, Rx, Ry), turned = over / under;
    const double along_x = -Ry * turned + By, along_y = Rx * turned - Bx; /* of the link */
    const double of_over = turn(along_x, along_y, Bx, By) - (lx * Bx + ly * By);
    const double of_under = turn(along_x, along_y, Rx, Ry) - turned * (lx * Rx + ly * Ry);
    const double of_turned = (of_over - turned * of_under) / under;
    double of_drive;
    const double drive = arm_of(of, theta, &of_drive);
    *slope = of_drive * turned * turned + drive * of_turned;
    return drive * turned;
}

static PyObject *arms_of(PyObject *const *args, Py_ssize_t count, const char *name, int slopes)
{
    Mat q, constants;
    Ind joint_of;
    double *found;
    if (count_is(count, 3, name) < 0 || as_mat(args[0], "q", -1, -1, &q) < 0 ||
        as_ind(args[1], "joint_of", q.columns, &joint_of) < 0 ||
        as_mat(args[2], "constants", joint_of.n, COLUMNS, &constants) < 0)
        return NULL;
    PyObject *arms = new_mat(q.rows, joint_of.n, &found);
    for (npy_intp i = 0; arms && i < joint_of.n; i++) {
        double own[COLUMNS], slope;
        for (int c = 0; c < COLUMNS; c++)
            own[c] = AT2(constants, i, c);
        const Linkage of = {own[0], own[1], own[2], own[3], own[4], own[5], own[6], own[7], own[8], own[9], own[10]};
        for (npy_intp k = 0; k < q.rows; k++) {
            const double angle = AT2(q, k, INDEX(joint_of, i));
            const double arm = of.side == 0.0 ? arm_of(&of, angle, &slope) : arm_over_rocker(&of, angle, &slope);
            found[k * joint_of.n + i] = slopes ? slope : arm;
        }
    }
    return arms;
}

PyObject *linkage_arms(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    return arms_of(args, count, "linkage_arms", 0);
}

PyObject *linkage_arm_slopes(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    return arms_of(args, count, "linkage_arm_slopes", 1);
}
