/* Which configurations keep their clearances: by balls around links, then by whether two pieces come nearer. */
#include "screen.h"

#include <math.h>

/* The poses 1 to n of the joints of one configuration; pose 0 is that of the base. */
static void place(Pose *pose, const double (*f)[33], const double *slides, const Mat *q, npy_intp row, npy_intp n)
{
    for (npy_intp j = 0; j < n; j++) {
        const Pose *from = pose + j;
        Pose *to = pose + j + 1;
        const double angle = AT2(*q, row, j), *g = f[j];
        double own[9]; /* column by column */
        if (slides[j] != 0.0)
            for (int k = 0; k < 9; k++)
                own[k] = g[k];
        else {
            const double sine = sin(angle), versine = 1.0 - cos(angle);
            for (int k = 0; k < 9; k++)
                own[k] = g[k] + sine * g[9 + k] + versine * g[18 + k];
        }
        const double run = slides[j] != 0.0 ? angle : 0.0;
        for (int r = 0; r < 3; r++) {
            const double *R = from->R + 3 * r;
            for (int c = 0; c < 3; c++)
                to->R[3 * r + c] = R[0] * own[3 * c] + R[1] * own[3 * c + 1] + R[2] * own[3 * c + 2];
            to->t[r] = from->t[r] + R[0] * (g[30] + run * g[27]) + R[1] * (g[31] + run * g[28]) +
                       R[2] * (g[32] + run * g[29]);
        }
    }
}

void moved(const Pose *pose, const double *x, double *into)
{
    for (int r = 0; r < 3; r++)
        into[r] = pose->t[r] + pose->R[3 * r] * x[0] + pose->R[3 * r + 1] * x[1] + pose->R[3 * r + 2] * x[2];
}

/* The squared distance of a point from a box: its axes row by row (9), its middle along them (3), half edges (3). */
static double off_box(const double *box, const double *x)
{
    double square = 0.0;
    for (int k = 0; k < 3; k++) {
        const double along = box[3 * k] * x[0] + box[3 * k + 1] * x[1] + box[3 * k + 2] * x[2];
        const double out = fabs(along - box[9 + k]) - box[12 + k];
        if (out > 0.0)
            square += out * out;
    }
    return square;
}

/* A direction in the world, from that in the frame of a pose. */
static void turned(const Pose *pose, const double *local, double *n)
{
    for (int r = 0; r < 3; r++)
        n[r] = pose->R[3 * r] * local[0] + pose->R[3 * r + 1] * local[1] + pose->R[3 * r + 2] * local[2];
}

/* The same back. */
static void turned_back(const Pose *pose, const double *n, double *local)
{
    for (int k = 0; k < 3; k++)
        local[k] = pose->R[k] * n[0] + pose->R[3 + k] * n[1] + pose->R[6 + k] * n[2];
}

/* Two numbers side by side, anywhere in memory: processors compute with both at once. */
typedef double Two __attribute__((vector_size(16), aligned(8), may_alias));
typedef npy_int64 Flags __attribute__((vector_size(16))); /* of a comparison: all bits are set, or none */

/* Two corners, and how far they are along a direction. */
typedef struct {
    Two most;
    Flags found;
} Furthest;

static inline void look_at_two(Furthest *so_far, const Corners *corners, const double *n, npy_intp i)
{
    const Two along = n[0] * *(const Two *)(corners->x + i) + n[1] * *(const Two *)(corners->y + i) +
                      n[2] * *(const Two *)(corners->z + i);
    const Flags is_more = (Flags)(along > so_far->most), here = {i, i + 1};
    so_far->most = (Two)(((Flags)along & is_more) | ((Flags)so_far->most & ~is_more));
    so_far->found = (here & is_more) | (so_far->found & ~is_more);
}

/* The first of the corners that are furthest along a direction in their own frame. */
static npy_intp furthest_of(const Corners *corners, const double *n)
{
    Furthest parts[2] = {{{-INFINITY, -INFINITY}, {0, 0}}, {{-INFINITY, -INFINITY}, {0, 0}}};
    npy_intp best = 0, i = 0;
    double furthest = -INFINITY;
    for (; i + 4 <= corners->count; i += 4)
        look_at_two(parts, corners, n, i), look_at_two(parts + 1, corners, n, i + 2);
    for (int k = 0; k < 4; k++) {
        const double along = parts[k / 2].most[k % 2];
        const npy_intp found = (npy_intp)parts[k / 2].found[k % 2];
        if (along > furthest || (along == furthest && found < best))
            furthest = along, best = found;
    }
    for (; i < corners->count; i++) {
        const double along = n[0] * corners->x[i] + n[1] * corners->y[i] + n[2] * corners->z[i];
        if (along > furthest)
            furthest = along, best = i;
    }
    return best;
}

/* The corner that is furthest along a direction, world; a `Support`. */
void furthest_corner(const void *of, const double *n, double *point)
{
    const Corners *corners = of;
    double local[3];
    turned_back(corners->pose, n, local);
    const npy_intp found = furthest_of(corners, local);
    moved(corners->pose, (double[]){corners->x[found], corners->y[found], corners->z[found]}, point);
}

int read_screen(PyObject *const *args, Screen *s)
{
    npy_intp coarse[2], fine[2], corner[2], radius[1], box[2];
    if (as_mat(args[1], "factors", 33, -1, &s->factors) < 0 || some_joints(s->factors.columns) < 0 ||
        as_mat(args[0], "q", -1, s->factors.columns, &s->q) < 0 ||
        as_vec(args[2], "slides", s->factors.columns, &s->slides) < 0 ||
        as_ind(args[3], "joint", s->factors.columns + 1, &s->joint) < 0 ||
        !(s->coarse = block(args[4], "coarse", 2, coarse)) || !(s->fine = block(args[6], "fine", 2, fine)) ||
        !(s->corner = block(args[8], "corners", 2, corner)) || !(s->radius = block(args[9], "radius", 1, radius)) ||
        !(s->box = block(args[10], "boxes", 2, box)))
        return -1;
    s->own = s->joint.n, s->every = radius[0], s->corners = corner[1], s->balls = fine[0];
    if (has_length(coarse[0], s->own, "coarse") < 0 || has_length(coarse[1], 4, "coarse") < 0 ||
        has_length(fine[1], 4, "fine") < 0 || has_length(corner[0], 3, "corners") < 0 ||
        has_length(box[0], s->every - s->own, "boxes") < 0 || has_length(box[1], 15, "boxes") < 0 ||
        as_ind(args[5], "starts", fine[0] + 1, &s->starts) < 0 || has_length(s->starts.n, s->own + 1, "starts") < 0 ||
        as_ind(args[7], "corner_starts", s->corners + 1, &s->corner_starts) < 0 ||
        has_length(s->corner_starts.n, s->every + 1, "corner_starts") < 0 ||
        as_vec(args[13], "least", -1, &s->least) < 0 || as_ind(args[11], "first", s->own, &s->first) < 0 ||
        has_length(s->first.n, s->least.n, "first") < 0 || as_ind(args[12], "second", s->every, &s->second) < 0 ||
        has_length(s->second.n, s->least.n, "second") < 0)
        return -1;
    return as_out(args[14], "normals", s->least.n, 3, &s->normals);
}

Corners corners_of(const Screen *s, npy_intp piece, const Pose *pose)
{
    const npy_intp begin = INDEX(s->corner_starts, piece), end = INDEX(s->corner_starts, piece + 1);
    const double *x = s->corner + begin;
    return (Corners){x, x + s->corners, x + 2 * s->corners, end - begin, s->radius[piece],
                  pose + (piece < s->own ? INDEX(s->joint, piece) : 0)};
}

/* Whether two pieces are `least` apart; `normal`, from the first to the second, begins as a guess. */
static Verdict verdict_of(const Corners *from, const Corners *to, double least, double *normal)
{
    const int nearer = come_nearer(furthest_corner, from, to, least + from->radius + to->radius, normal);
    return nearer > 0 ? NEARER : nearer == 0 ? APART : UNDECIDED;
}

/* The normal that is kept of a pair, world; left as it is if none is. */
static void take_kept(const Screen *s, npy_intp pair, const Pose *pose, double *normal)
{
    double kept[3], size = 0.0;
    for (int k = 0; k < 3; k++)
        kept[k] = AT2(s->normals, pair, k), size += fabs(kept[k]);
    if (size > 0.0)
        turned(pose, kept, normal);
}

static void keep_normal(const Screen *s, npy_intp pair, const Pose *pose, const double *normal)
{
    double kept[3];
    turned_back(pose, normal, kept);
    for (int k = 0; k < 3; k++)
        AT2(s->normals, pair, k) = kept[k];
}

/* Whether two pieces are `least` apart, by a plane across the normal that proved it last, or the given one where none did;
 * one that proves it is kept, in the frame of the second. */
static Verdict verdict_from_kept(const Screen *s, npy_intp pair, const Corners *from, const Corners *to, double least,
                                 double *normal)
{
    take_kept(s, pair, to->pose, normal);
    const Verdict verdict = verdict_of(from, to, least, normal);
    if (verdict == APART)
        keep_normal(s, pair, to->pose, normal);
    return verdict;
}

int distance_from_kept(const Screen *s, npy_intp pair, const Pose *pose, double reach, double *distance, double *normal,
                       double *point)
{
    const Corners from = corners_of(s, INDEX(s->first, pair), pose), to = corners_of(s, INDEX(s->second, pair), pose);
    double other[3];
    if (from.count < 1 || to.count < 1)
        return -1;
    normal[0] = normal[1] = normal[2] = 0.0;
    take_kept(s, pair, to.pose, normal);
    const double radii = from.radius + to.radius;
    const int found = distance_within(furthest_corner, &from, &to, reach + radii, normal, distance, point, other);
    if (found >= 0) {
        *distance -= radii;
        keep_normal(s, pair, to.pose, normal);
    }
    return found;
}

/* What is known of piece `a`, with its coarse ball at `centre`, and a half-space. */
static Verdict off_halfspace(const Screen *s, npy_intp a, const double *box, const double *centre, double least,
                             const Pose *pose)
{
    if (box[0] * centre[0] + box[1] * centre[1] + box[2] * centre[2] - box[9] - s->coarse[4 * a + 3] >= least)
        return APART;
    const Corners corners = corners_of(s, a, pose);
    const double down[3] = {-box[0], -box[1], -box[2]};
    double lowest[3];
    furthest_corner(&corners, down, lowest);
    const double gap = box[0] * lowest[0] + box[1] * lowest[1] + box[2] * lowest[2] - box[9] - corners.radius;
    return gap >= least ? APART : NEARER;
}

/* The same of piece `a` and another body `b` within a box. */
static Verdict off_body(const Screen *s, npy_intp a, npy_intp b, const double *box, const double *centre, double least,
                        const double (*ball)[3], const Pose *pose)
{
    double reach = least + s->radius[b] + s->coarse[4 * a + 3];
    if (reach > 0.0 && off_box(box, centre) >= reach * reach)
        return APART;
    double lowest = INFINITY;
    const double *deepest = centre;
    int apart = 1;
    for (npy_intp i = INDEX(s->starts, a); i < INDEX(s->starts, a + 1); i++) {
        const double square = off_box(box, ball[i]);
        reach = least + s->radius[b] + s->fine[4 * i + 3];
        apart = apart && reach > 0.0 && square >= reach * reach;
        if (square < lowest)
            lowest = square, deepest = ball[i];
    }
    if (apart)
        return APART;
    double normal[3] = {0.0, 0.0, 0.0}; /* from that ball straight to the box, or to its middle */
    for (int k = 0; k < 3; k++) {
        const double along = box[3 * k] * deepest[0] + box[3 * k + 1] * deepest[1] + box[3 * k + 2] * deepest[2];
        const double off = along - box[9 + k], out = lowest > 0.0 ? fmax(fabs(off) - box[12 + k], 0.0) : fabs(off);
        for (int r = 0; r < 3; r++)
            normal[r] -= (off > 0.0 ? out : -out) * box[3 * k + r];
    }
    const Corners from = corners_of(s, a, pose), to = corners_of(s, b, pose);
    return verdict_of(&from, &to, least, normal);
}

/* Whether all smaller balls of two of the machine's pieces are `least` apart; `ball` are their centres. */
static int fine_apart(const Screen *s, npy_intp a, npy_intp b, double least, const double (*ball)[3])
{
    for (npy_intp i = INDEX(s->starts, a); i < INDEX(s->starts, a + 1); i++)
        for (npy_intp k = INDEX(s->starts, b); k < INDEX(s->starts, b + 1); k++) {
            const double x = ball[i][0] - ball[k][0], y = ball[i][1] - ball[k][1], z = ball[i][2] - ball[k][2];
            const double reach = least + s->fine[4 * i + 3] + s->fine[4 * k + 3];
            if (!(reach > 0.0 && x * x + y * y + z * z >= reach * reach))
                return 0;
        }
    return 1;
}

/* What is known of two of the machine's pieces; the normal that proves it is kept for the next configuration. */
static Verdict off_own(const Screen *s, npy_intp pair, npy_intp a, npy_intp b, const double (*centre)[3],
                       const double (*ball)[3], double least, const Pose *pose)
{
    double normal[3], square = 0.0;
    const double reach = least + s->coarse[4 * a + 3] + s->coarse[4 * b + 3];
    for (int k = 0; k < 3; k++)
        normal[k] = centre[b][k] - centre[a][k], square += normal[k] * normal[k];
    if (reach > 0.0 && square >= reach * reach)
        return APART;
    if (fine_apart(s, a, b, least, ball))
        return APART;
    const Corners from = corners_of(s, a, pose), to = corners_of(s, b, pose);
    return verdict_from_kept(s, pair, &from, &to, least, normal);
}

int machine_of(const Screen *s, Machine *m)
{
    m->pose[0] = (Pose){{1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0}, {0.0, 0.0, 0.0}};
    for (npy_intp j = 0; j < s->factors.columns; j++) {
        m->slides[j] = AT(s->slides, j);
        for (int k = 0; k < 33; k++)
            m->factors[j][k] = AT2(s->factors, k, j);
    }
    m->centre = room_for(&m->room, (s->own + s->balls + 1) * sizeof *m->centre);
    m->ball = m->centre + s->own;
    return m->centre ? 0 : -1;
}

void place_at(const Screen *s, Machine *m, npy_intp row)
{
    place(m->pose, m->factors, m->slides, &s->q, row, s->factors.columns);
    for (npy_intp a = 0; a < s->own; a++) {
        const Pose *of = m->pose + INDEX(s->joint, a);
        if (s->coarse)
            moved(of, s->coarse + 4 * a, m->centre[a]);
        for (npy_intp i = INDEX(s->starts, a); i < INDEX(s->starts, a + 1); i++)
            moved(of, s->fine + 4 * i, m->ball[i]);
    }
}

static Verdict look_at(const Screen *s, const Machine *m, npy_intp pair)
{
    const npy_intp a = INDEX(s->first, pair), b = INDEX(s->second, pair);
    const double least = AT(s->least, pair), (*centre)[3] = m->centre, (*ball)[3] = m->ball;
    if (b < s->own)
        return off_own(s, pair, a, b, centre, ball, least, m->pose);
    const double *box = s->box + 15 * (b - s->own);
    if (box[12] < 0.0)
        return off_halfspace(s, a, box, centre[a], least, m->pose);
    return off_body(s, a, b, box, centre[a], least, ball, m->pose);
}

PyObject *first_not_apart(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Screen s;
    Machine m;
    if (count_is(count, 15, "first_not_apart") < 0 || read_screen(args, &s) < 0 || machine_of(&s, &m) < 0)
        return NULL;
    Verdict verdict = APART;
    npy_intp row = 0;
    for (; row < s.q.rows; row++) {
        place_at(&s, &m, row);
        for (npy_intp pair = 0; pair < s.least.n && verdict != NEARER; pair++) {
            const Verdict of_pair = look_at(&s, &m, pair);
            verdict = of_pair == APART ? verdict : of_pair;
        }
        if (verdict != APART)
            break;
    }
    release(&m.room);
    return Py_BuildValue("nO", row, verdict == NEARER ? Py_True : Py_False);
}

PyObject *pairs_not_apart(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Screen s;
    Machine m;
    npy_intp *found;
    if (count_is(count, 15, "pairs_not_apart") < 0 || read_screen(args, &s) < 0 ||
        has_length(s.q.rows, 1, "q") < 0 || machine_of(&s, &m) < 0)
        return NULL;
    Room room;
    if (!(found = room_for(&room, (s.least.n + 1) * sizeof *found))) {
        release(&m.room);
        return NULL;
    }
    npy_intp some = 0;
    place_at(&s, &m, 0);
    for (npy_intp pair = 0; pair < s.least.n; pair++)
        if (look_at(&s, &m, pair) != APART)
            found[some++] = pair;
    PyObject *pairs = ind_of(found, some);
    release(&room), release(&m.room);
    return pairs;
}

/* A distance with this square, less the radii of two balls, if that is less than the least so far; most are not, by squares. */
static double lesser(double square, double radii, double least)
{
    const double reach = least + radii;
    return reach > 0.0 && square < reach * reach ? sqrt(square) - radii : least;
}

/* The least distance between the smaller balls of two pieces, or of one and a body; `rounder` has the radii of bodies. */
double balls_apart(const Screen *s, npy_intp a, npy_intp b, const double (*ball)[3], const double *rounder)
{
    const double *box = b < s->own ? NULL : s->box + 15 * (b - s->own);
    double least = INFINITY;
    for (npy_intp i = INDEX(s->starts, a); i < INDEX(s->starts, a + 1); i++) {
        const double own = s->fine[4 * i + 3];
        if (!box) {
            for (npy_intp k = INDEX(s->starts, b); k < INDEX(s->starts, b + 1); k++) {
                const double x = ball[i][0] - ball[k][0], y = ball[i][1] - ball[k][1], z = ball[i][2] - ball[k][2];
                least = lesser(x * x + y * y + z * z, own + s->fine[4 * k + 3], least);
            }
        } else if (box[12] < 0.0)
            least = fmin(least, box[0] * ball[i][0] + box[1] * ball[i][1] + box[2] * ball[i][2] - box[9] - own);
        else
            least = lesser(off_box(box, ball[i]), own + rounder[b - s->own], least);
    }
    return least;
}

PyObject *ball_bounds(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    Screen s = {0};
    Machine m;
    npy_intp fine[2], box[2], radius[1];
    if (count_is(count, 10, "ball_bounds") < 0 || as_mat(args[1], "factors", 33, -1, &s.factors) < 0 ||
        some_joints(s.factors.columns) < 0 || as_mat(args[0], "q", -1, s.factors.columns, &s.q) < 0 ||
        as_vec(args[2], "slides", s.factors.columns, &s.slides) < 0 ||
        as_ind(args[3], "joint", s.factors.columns + 1, &s.joint) < 0 || !(s.fine = block(args[5], "fine", 2, fine)) ||
        !(s.box = block(args[6], "boxes", 2, box)) || !(s.radius = block(args[7], "radius", 1, radius)) ||
        has_length(fine[1], 4, "fine") < 0 || has_length(box[1], 15, "boxes") < 0 ||
        has_length(radius[0], box[0], "radius") < 0 || as_ind(args[4], "starts", fine[0] + 1, &s.starts) < 0 ||
        has_length(s.starts.n, s.joint.n + 1, "starts") < 0 || as_ind(args[8], "first", s.joint.n, &s.first) < 0 ||
        as_ind(args[9], "second", s.joint.n + box[0], &s.second) < 0 ||
        has_length(s.second.n, s.first.n, "second") < 0)
        return NULL;
    s.own = s.joint.n, s.balls = fine[0];
    double *found;
    PyObject *bounds = new_mat(s.q.rows, s.first.n, &found);
    if (!bounds)
        return NULL;
    if (machine_of(&s, &m) < 0) {
        Py_DECREF(bounds);
        return NULL;
    }
    for (npy_intp row = 0; row < s.q.rows; row++) {
        place_at(&s, &m, row);
        for (npy_intp pair = 0; pair < s.first.n; pair++)
            *found++ = balls_apart(&s, INDEX(s.first, pair), INDEX(s.second, pair), (const double (*)[3])m.ball, s.radius);
    }
    release(&m.room);
    return bounds;
}
