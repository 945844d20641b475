/* Arrays as the functions of this extension take and return them: doubles and indices, with any strides.
 *
 * What a function computes is explained where its plain version stands, in backhoe_planner. Shapes and indices are
 * checked here, so that no argument reaches beyond an array. */
#ifndef BACKHOE_ARRAYS_H
#define BACKHOE_ARRAYS_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#define NPY_NO_DEPRECATED_API NPY_2_0_API_VERSION
#define PY_ARRAY_UNIQUE_SYMBOL backhoe_planner_native_arrays
#ifndef BACKHOE_MODULE
#define NO_IMPORT_ARRAY
#endif
#include <numpy/arrayobject.h>

#define MOST_JOINTS 32 /* with more of them the plain version answers, see module.c */
#define MOST_TASKS 6

/* (n,) doubles; step in bytes */
typedef struct {
    char *data;
    npy_intp n, step;
} Vec;

/* (rows, columns) doubles */
typedef struct {
    char *data;
    npy_intp rows, columns, down, right;
} Mat;

/* (n,) indices */
typedef struct {
    char *data;
    npy_intp n, step;
} Ind;

/* (n,) truth values */
typedef struct {
    char *data;
    npy_intp n, step;
} Flg;

#define AT(v, i) (*(double *)((v).data + (i) * (v).step))
#define AT2(m, i, j) (*(double *)((m).data + (i) * (m).down + (j) * (m).right))
#define INDEX(v, i) (*(npy_intp *)((v).data + (i) * (v).step))
#define FLAG(v, i) (*(npy_bool *)((v).data + (i) * (v).step))

/* Each returns 0, or -1 with an exception where the object is not such an array. A length of -1 is any. */
int as_vec(PyObject *object, const char *name, npy_intp length, Vec *out);
int as_mat(PyObject *object, const char *name, npy_intp rows, npy_intp columns, Mat *out);
int as_out(PyObject *object, const char *name, npy_intp rows, npy_intp columns, Mat *out); /* one to write to */
int as_ind(PyObject *object, const char *name, npy_intp below, Ind *out);
/* the same of all P pairs, of which those of `pairs`, which are below P, are looked at; all where there are none */
int as_rows(PyObject *object, const char *name, npy_intp below, npy_intp length, const Ind *pairs, Ind *out);
int as_flags(PyObject *object, const char *name, npy_intp length, Flg *out);
int has_length(npy_intp found, npy_intp wanted, const char *name);
/* of a type (NPY_DOUBLE, NPY_INTP, NPY_BOOL) and with so many axes, as the processor reads it */
int is_array(PyObject *object, const char *name, int kind, int axes);
int is_writeable(PyObject *object, const char *name);
/* doubles in one piece: the first of them, and in `shape` the length of each axis; or NULL with an exception */
const double *block(PyObject *object, const char *name, int axes, npy_intp *shape);
const npy_intp *index_block(PyObject *object, const char *name, int axes, npy_intp *shape); /* the same of indices */
int as_double(PyObject *object, const char *name, double *out);
int as_doubles(PyObject *tuple, const char *name, Py_ssize_t count, double *out);
/* `rows` tuples of as many numbers in a tuple: constants of each joint, as a plain version takes them quickest */
int as_table(PyObject *tuple, const char *name, Py_ssize_t rows, Py_ssize_t columns, double *out);
int some_joints(npy_intp n); /* 1 to MOST_JOINTS of them; else the exception is `joints_beyond` */
extern PyObject *joints_beyond;
int count_is(Py_ssize_t given, Py_ssize_t wanted, const char *function);

PyObject *new_vec(npy_intp n, double **data);
PyObject *new_mat(npy_intp rows, npy_intp columns, double **data);
PyObject *new_ind(npy_intp n, npy_intp **data);
PyObject *ind_of(const npy_intp *values, npy_intp n);

/* n things of a size, on the caller's stack where they fit: free with `release` */
typedef struct {
    double few[512];
    void *many;
} Room;
void *room_for(Room *room, size_t bytes);
void release(Room *room);

/* positive definite A (n, n), row by row: 0 and its Cholesky factor below the diagonal, or -1 */
int cholesky(double *A, int n);
void solve_cholesky(const double *L, int n, double *b);
/* symmetric A (n, n): its eigenvalues on the diagonal and its eigenvectors as columns of U, by Jacobi's rotations; or -1 */
int eigenvectors(double *A, int n, double *U);

/* All functions that Python sees, by the files that they stand in: kinematics, poses, pairs, clusters, law, shield, servo,
 * boxes, rows, odometers, screen, near, timing, programs, held, ground, rings, grids, cell_trees, rods, routes,
 * dynamics, goals, linkages, ways. */
#define FUNCTIONS(F) \
    F(placed_arrays) F(keep_placements) F(place_tip) F(damped_steps) F(chain_placements) F(solve_poses) \
    F(read_results) F(bounds_after) F(reach_of_lead) F(approach_rates) F(pairs_within) F(near_rows) \
    F(unproven_of_near) \
    F(off_turned_box) F(cells_of_tiles) F(split_by_plane) F(extent_along) \
    F(quick_terms) \
    F(step_conditions) F(nearest_safe_program) \
    F(reachable_velocities) F(straight_towards) F(changes_of_end) F(near_now) F(not_proven) F(margins_now) \
    F(stalest_pair) F(corner_gaps) F(blended_points) F(plane_rows) F(force_on_hand) \
    F(line_ahead) F(inexact_boxes) F(box_urgency) F(ways_of_links) \
    F(binding_corners) F(rows_by_velocity) F(place_on_line) F(bend_in_parts) F(least_over_path) F(cost_of_tip) \
    F(next_within) \
    F(count_travel) F(keep_proven) F(note_gaps) F(braking_line) F(largest_part) F(left_over_path) F(keeps_rows) \
    F(first_not_apart) F(pairs_not_apart) F(ball_bounds) F(fastest_run) F(soft_solution) \
    F(velocity_within_rows) F(rows_of_path) F(turn_along_surface) F(near_gaps) F(nearest_rows) F(gaps_along_path) \
    F(tightest_pair) F(known_apart) F(boxes_of_cells) F(boxes_of_voxels) F(put_planes) F(hulls_apart) \
    F(most_urgent_boxes) F(lower_on_grid) F(velocity_held_as_before) \
    F(nearest_on_ground) F(kept_over_ground) F(read_over_ground) F(distances_within) \
    F(lower_over_heights) F(nearest_on_cells) F(least_on_grid) F(kept_over_cells) F(read_over_cells) \
    F(cheapest_with_turns) F(rod_limits) F(rod_limit_slopes) F(rod_forces) \
    F(oil_taken) F(rod_flow_slopes) F(least_supplied) F(chain_torques) F(chain_torque_slopes) F(chain_energies) \
    F(missed_up_to) F(contracted) F(second_order) F(linkage_arms) F(linkage_arm_slopes) F(ways_of_pairs)
#define DECLARED(name) PyObject *name(PyObject *, PyObject *const *, Py_ssize_t);
FUNCTIONS(DECLARED)

#endif
