/* What the rods of cylinders allow their joints, and what oil they take: machine/hydraulics/rods.py. */
#include "arrays.h"

#include <math.h>

/* Moment arms (K, m), and the cylinders, as all functions here take them. */
typedef struct {
    Mat arms;
    Ind joint_of;
    Vec cap, annulus;
} Rods;

static int as_rods(PyObject *arms, PyObject *joint_of, npy_intp joints, Rods *rods)
{
    return as_mat(arms, "arms", -1, -1, &rods->arms) < 0 || as_ind(joint_of, "joint_of", joints, &rods->joint_of) < 0 ||
                   has_length(rods->joint_of.n, rods->arms.columns, "joint_of") < 0
               ? -1
               : 0;
}

static int as_areas(PyObject *cap, PyObject *annulus, Rods *rods)
{
    return as_vec(cap, "cap", rods->arms.columns, &rods->cap) < 0 ||
                   as_vec(annulus, "annulus", rods->arms.columns, &rods->annulus) < 0
               ? -1
               : 0;
}

/* The area that oil presses on where this is positive, or not. */
static double area_of(const Rods *rods, npy_intp i, double way)
{
    return way > 0.0 ? AT(rods->cap, i) : AT(rods->annulus, i);
}

static double sign_of(double x)
{
    return x > 0.0 ? 1.0 : x < 0.0 ? -1.0 : x == 0.0 ? 0.0 : NAN;
}

static double less(double a, double b) /* as numpy's minimum: what is no number is kept */
{
    return isnan(a) || a < b ? a : b;
}

typedef struct {
    Vec valve_flow;
    double pressure, pump_flow;
} Oil;

static int as_oil(PyObject *const *args, npy_intp cylinders, Oil *oil)
{
    return as_vec(args[0], "valve_flow", cylinders, &oil->valve_flow) < 0 ||
                   as_double(args[1], "pressure", &oil->pressure) < 0 ||
                   as_double(args[2], "pump_flow", &oil->pump_flow) < 0
               ? -1
               : 0;
}

static npy_intp as_joints(PyObject *number)
{
    const npy_intp n = PyLong_AsSsize_t(number);
    return (n == -1 && PyErr_Occurred()) || some_joints(n) < 0 ? -1 : n;
}

/* The greatest speeds (n,) of the joints one way, at one configuration. */
static void speeds_of(const Rods *rods, const Oil *oil, npy_intp k, double way, npy_intp n, double *speed)
{
    for (npy_intp j = 0; j < n; j++)
        speed[j] = 0.0;
    for (npy_intp i = 0; i < rods->arms.columns; i++) {
        const double arm = AT2(rods->arms, k, i);
        speed[INDEX(rods->joint_of, i)] += area_of(rods, i, way * arm) * fabs(arm);
    }
    for (npy_intp j = 0; j < n; j++)
        speed[j] = speed[j] > 0.0 ? oil->pump_flow / speed[j] : INFINITY;
    for (npy_intp i = 0; i < rods->arms.columns; i++) {
        const double arm = AT2(rods->arms, k, i), swept = area_of(rods, i, way * arm) * fabs(arm);
        double *own = &speed[INDEX(rods->joint_of, i)];
        *own = less(*own, swept > 0.0 ? AT(oil->valve_flow, i) / swept : INFINITY);
    }
}

/* Four new matrices (K, n) of zeros, torques and speeds either way; NULL without room. */
static PyObject *both_ways(npy_intp K, npy_intp n, double *torque[2], double *speed[2])
{
    PyObject *found = PyTuple_New(4);
    for (int part = 0; found && part < 4; part++) {
        double **data = part < 2 ? &torque[part] : &speed[part - 2];
        PyObject *one = new_mat(K, n, data);
        if (!one) {
            Py_DECREF(found);
            return NULL;
        }
        for (npy_intp k = 0; k < K * n; k++)
            (*data)[k] = 0.0;
        PyTuple_SET_ITEM(found, part, one);
    }
    return found;
}

PyObject *rod_limits(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Rods rods;
    Oil oil;
    npy_intp n;
    double *torque[2], *speed[2];
    if (count_is(count, 8, "rod_limits") < 0 || (n = as_joints(args[7])) < 0 ||
        as_rods(args[0], args[1], n, &rods) < 0 || as_areas(args[2], args[3], &rods) < 0 ||
        as_oil(args + 4, rods.arms.columns, &oil) < 0)
        return NULL;
    PyObject *found = both_ways(rods.arms.rows, n, torque, speed);
    if (!found)
        return NULL;
    int has_cylinder[MOST_JOINTS] = {0};
    for (npy_intp i = 0; i < rods.arms.columns; i++)
        has_cylinder[INDEX(rods.joint_of, i)] = 1;
    for (npy_intp k = 0; k < rods.arms.rows; k++)
        for (int back = 0; back < 2; back++) {
            const double way = back ? -1.0 : 1.0;
            double *own = torque[back] + k * n;
            for (npy_intp i = 0; i < rods.arms.columns; i++) {
                const double arm = AT2(rods.arms, k, i);
                own[INDEX(rods.joint_of, i)] += fabs(arm) * (oil.pressure * area_of(&rods, i, way * arm));
            }
            for (npy_intp j = 0; j < n; j++)
                if (!has_cylinder[j])
                    own[j] = INFINITY;
            speeds_of(&rods, &oil, k, way, n, speed[back] + k * n);
        }
    return found;
}

PyObject *rod_limit_slopes(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Rods rods;
    Mat slopes;
    Oil oil;
    npy_intp n;
    double *torque[2], *speed[2], limit[MOST_JOINTS];
    if (count_is(count, 9, "rod_limit_slopes") < 0 || (n = as_joints(args[8])) < 0 ||
        as_rods(args[0], args[2], n, &rods) < 0 ||
        as_mat(args[1], "arm_slopes", rods.arms.rows, rods.arms.columns, &slopes) < 0 ||
        as_areas(args[3], args[4], &rods) < 0 || as_oil(args + 5, rods.arms.columns, &oil) < 0)
        return NULL;
    PyObject *found = both_ways(rods.arms.rows, n, torque, speed);
    if (!found)
        return NULL;
    for (npy_intp k = 0; k < rods.arms.rows; k++)
        for (int back = 0; back < 2; back++) {
            const double way = back ? -1.0 : 1.0;
            double *of_torque = torque[back] + k * n, *of_speed = speed[back] + k * n;
            speeds_of(&rods, &oil, k, way, n, limit);
            for (npy_intp i = 0; i < rods.arms.columns; i++) {
                const double arm = AT2(rods.arms, k, i), grown = sign_of(arm) * AT2(slopes, k, i);
                const double area = area_of(&rods, i, way * arm);
                of_torque[INDEX(rods.joint_of, i)] += grown * (oil.pressure * area);
                of_speed[INDEX(rods.joint_of, i)] += area * grown;
            }
            for (npy_intp j = 0; j < n; j++)
                of_speed[j] /= oil.pump_flow;
            for (npy_intp i = 0; i < rods.arms.columns; i++) {
                const double arm = AT2(rods.arms, k, i), grown = sign_of(arm) * AT2(slopes, k, i);
                const double area = area_of(&rods, i, way * arm), flow = AT(oil.valve_flow, i);
                const npy_intp j = INDEX(rods.joint_of, i);
                if (flow / (area * fabs(arm)) == limit[j])
                    of_speed[j] = area * grown / flow;
            }
            for (npy_intp j = 0; j < n; j++)
                of_speed[j] = isfinite(limit[j]) ? -(limit[j] * limit[j]) * of_speed[j] : 0.0;
        }
    return found;
}

/* The forces (m,) at one configuration with these torques. */
static void forces_of(const Rods *rods, const Mat *torques, npy_intp k, double *force)
{
    double share[MOST_JOINTS] = {0.0};
    for (npy_intp i = 0; i < rods->arms.columns; i++)
        share[INDEX(rods->joint_of, i)] += AT2(rods->arms, k, i) * AT2(rods->arms, k, i);
    for (npy_intp i = 0; i < rods->arms.columns; i++) {
        const npy_intp j = INDEX(rods->joint_of, i);
        force[i] = AT2(rods->arms, k, i) * AT2(*torques, k, j) / share[j];
    }
}

PyObject *rod_forces(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Rods rods;
    Mat torques;
    double *force;
    if (count_is(count, 3, "rod_forces") < 0 || as_mat(args[2], "torques", -1, -1, &torques) < 0 ||
        some_joints(torques.columns) < 0 || as_rods(args[0], args[1], torques.columns, &rods) < 0 ||
        has_length(torques.rows, rods.arms.rows, "torques") < 0)
        return NULL;
    PyObject *found = new_mat(rods.arms.rows, rods.arms.columns, &force);
    for (npy_intp k = 0; found && k < rods.arms.rows; k++)
        forces_of(&rods, &torques, k, force + k * rods.arms.columns);
    return found;
}

PyObject *oil_taken(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Rods rods;
    Mat v, torques;
    Room room;
    double *flow, *power, *highest;
    if (count_is(count, 6, "oil_taken") < 0 || as_mat(args[4], "v", -1, -1, &v) < 0 || some_joints(v.columns) < 0 ||
        as_mat(args[5], "torques", v.rows, v.columns, &torques) < 0 ||
        as_rods(args[0], args[1], v.columns, &rods) < 0 || as_areas(args[2], args[3], &rods) < 0 ||
        has_length(v.rows, rods.arms.rows, "v") < 0)
        return NULL;
    double *force = room_for(&room, (rods.arms.columns + 1) * sizeof(double));
    if (!force)
        return NULL;
    PyObject *flows = new_vec(v.rows, &flow), *powers = new_vec(v.rows, &power), *most = new_vec(v.rows, &highest);
    if (!flows || !powers || !most) {
        Py_XDECREF(flows), Py_XDECREF(powers), Py_XDECREF(most);
        release(&room);
        return NULL;
    }
    for (npy_intp k = 0; k < v.rows; k++) {
        forces_of(&rods, &torques, k, force);
        flow[k] = power[k] = highest[k] = 0.0;
        for (npy_intp i = 0; i < rods.arms.columns; i++) {
            const double speed = AT2(rods.arms, k, i) * AT2(v, k, INDEX(rods.joint_of, i));
            const double own = fabs(speed) * area_of(&rods, i, speed);
            const double pressure = force[i] * speed > 0.0 ? fabs(force[i]) / area_of(&rods, i, force[i]) : 0.0;
            flow[k] += own;
            power[k] += pressure * own;
            if (pressure > highest[k])
                highest[k] = pressure;
        }
    }
    release(&room);
    return Py_BuildValue("NNN", flows, powers, most);
}

PyObject *rod_flow_slopes(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Rods rods;
    Mat slopes, v;
    double *by_q, *by_v;
    if (count_is(count, 6, "rod_flow_slopes") < 0 || as_mat(args[5], "v", -1, -1, &v) < 0 ||
        some_joints(v.columns) < 0 || as_rods(args[0], args[2], v.columns, &rods) < 0 ||
        as_mat(args[1], "arm_slopes", rods.arms.rows, rods.arms.columns, &slopes) < 0 ||
        as_areas(args[3], args[4], &rods) < 0 || has_length(v.rows, rods.arms.rows, "v") < 0)
        return NULL;
    PyObject *of_q = new_mat(v.rows, v.columns, &by_q), *of_v = new_mat(v.rows, v.columns, &by_v);
    if (!of_q || !of_v) {
        Py_XDECREF(of_q), Py_XDECREF(of_v);
        return NULL;
    }
    for (npy_intp k = 0; k < v.rows * v.columns; k++)
        by_q[k] = by_v[k] = 0.0;
    for (npy_intp k = 0; k < v.rows; k++)
        for (npy_intp i = 0; i < rods.arms.columns; i++) {
            const npy_intp at = k * v.columns + INDEX(rods.joint_of, i);
            const double arm = AT2(rods.arms, k, i), own = AT2(v, k, INDEX(rods.joint_of, i));
            const double way = own < 0.0 ? -1.0 : 1.0, area = area_of(&rods, i, way * arm);
            by_q[at] += fabs(own) * area * sign_of(arm) * AT2(slopes, k, i);
            by_v[at] += way * area * fabs(arm);
        }
    return Py_BuildValue("NN", of_q, of_v);
}
