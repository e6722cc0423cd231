/* The reach set of a sampled loop, sample by sample, as pieces.
 *
 * A piece is a set of states that share the label in force and the number of samples so far. At a
 * sample it is cut into parts whose measured states have one label each, and these flow under it. A
 * piece ends where all cells under it are won in its layer, that of the label in force, or where it
 * is in the target; or after a number of samples, where the loop is to stay. Cuts cover, hulls and
 * fewer vertices only grow, flows enclose: so every solution from the first piece is in one of the
 * pieces at each sample.
 */
#define MOST_PIECES 128
#define MOST_PARTS 256
#define MOST_UNDER 4096 /* cells under a piece that ends */

enum { PROVED, LEFT, AVOIDED, UNBOUNDED, TOO_MANY, TOO_LONG, NOT_WON };

typedef struct {
    shape s;
    double error[STATES];
    int32_t held, samples, switches, id, jump; /* the samples that it flowed at once last */
} piece;

/* What is told of a proof: a piece that was gone through, and a part of it that flowed. */
typedef struct {
    double v[SHAPE_SIZE], error[STATES];
    int32_t count, held, samples, ended, id, merged;
} told_piece;

typedef struct {
    double v[SHAPE_SIZE], error[STATES];
    int32_t count, label, samples, start, end, waits;
} told_flow;

typedef struct {
    const int32_t *second, *row, *next; /* nodes: second child, row of a leaf or -1; rows x LABELS */
    const double *normal, *below, *above; /* nodes x STATES: a first child has a . x < below */
    const double *controls, *parameters;  /* LABELS x CONTROLS; 2 x PARAMETERS */
    const double *lower, *upper, *widths; /* domain */
    const uint8_t *periodic;
    const double *noise;
    const volatile int32_t *stop; /* not 0: what is not done is not proved */
    const int64_t *holds, *kinds; /* LABELS: samples that a label is held; equal: no switch */
    const double *grid_lower, *grid_upper, *cell; /* of the cells */
    const int64_t *counts;
    double *bound; /* layers x cells: time to arrive, infinite where that is not proved */
    uint8_t *marks; /* layers x cells that a loop that is to stay may be in at its end */
    told_piece *pieces;
    told_flow *flows;
    int64_t layers, cells, horizon, record, nearest, piece_room, flow_room;
    double sample, delay;
    int64_t piece_count, flow_count;
} task;

typedef struct {
    int32_t label;
    shape s;
} part;

typedef struct {
    const task *t;
    const piece *p;
    double reach[STATES]; /* error and noise */
    int exact;            /* the piece is half-open cells themselves */
    int count, fine;
    part parts[MOST_PARTS];
} cutting;

/* The parts of a shape below a node of the tree, whose states are moved by whole periods. */
static void cut_below(cutting *c, const int32_t node, const shape *s, const double *moved)
{
    const task *t = c->t;
    if (t->row[node] >= 0) {
        if (c->count == MOST_PARTS) {
            c->fine = 0;
            return;
        }
        c->parts[c->count].label = t->next[t->row[node] * LABELS + c->p->held];
        c->parts[c->count++].s = *s;
        return;
    }
    const double *a = t->normal + (int64_t)node * STATES;
    double least, most, reach = 0, size = 0, at = 0;
    along(s, a, &least, &most);
    for (int i = 0; i < STATES; ++i)
        reach += fabs(a[i]) * c->reach[i], at += a[i] * moved[i], size += fabs(a[i] * moved[i]);
    const double below = t->below[node] + at, above = t->above[node] + at;
    size += fabs(least) + fabs(most) + fabs(below) + fabs(above);
    if (!c->exact)
        reach += 4 * slack(size);
    const int first = least - reach < below, second = most + reach > above;
    if (first && second) {
        shape half;
        double back[STATES];
        const int start = c->count;
        const double margin = reach + 4 * slack(size);
        for (int i = 0; i < STATES; ++i)
            back[i] = -a[i];
        if (cut_off(s, a, below + margin, &half))
            cut_below(c, node + 1, &half, moved);
        if (cut_off(s, back, -(above - margin), &half))
            cut_below(c, t->second[node], &half, moved);
        int same = c->count > start;
        for (int k = start + 1; k < c->count; ++k)
            same &= c->parts[k].label == c->parts[start].label;
        if (same && c->count > start + 1) { /* one label: it stays whole */
            c->count = start + 1;
            c->parts[start].s = *s;
        }
    } else /* what is not below is beyond, where neither bound is met */
        cut_below(c, first ? node + 1 : t->second[node], s, moved);
}

/* The parts of a shape in each copy of the domain, a period apart. */
static void cut_copies(cutting *c, const int axis, const shape *s, double *moved)
{
    const task *t = c->t;
    if (axis == STATES) {
        cut_below(c, 0, s, moved);
        return;
    }
    double lower[STATES], upper[STATES];
    moved[axis] = 0;
    if (!t->periodic[axis]) {
        cut_copies(c, axis + 1, s, moved);
        return;
    }
    bounds_of(s, lower, upper);
    const double reach = c->exact ? 0 : c->reach[axis], period = t->widths[axis];
    const double low = floor((lower[axis] - reach - t->lower[axis]) / period);
    const double high = ceil((upper[axis] + reach - t->lower[axis]) / period) - 1;
    const int start = c->count;
    for (double k = low; k <= greater(high, low) && c->fine; ++k) {
        double a[STATES] = {0};
        shape one, two;
        const shape *here = s;
        const double margin = reach + 8 * slack(fabs(k) * period + fabs(t->upper[axis]));
        a[axis] = 1;
        if (k < high) {
            if (!cut_off(here, a, t->upper[axis] + k * period + margin, &one))
                continue;
            here = &one;
        }
        a[axis] = -1;
        if (k > low) {
            if (!cut_off(here, a, -(t->lower[axis] + k * period - margin), &two))
                continue;
            here = &two;
        }
        moved[axis] = k * period;
        cut_copies(c, axis + 1, here, moved);
    }
    int same = c->count > start;
    for (int k = start + 1; k < c->count; ++k)
        same &= c->parts[k].label == c->parts[start].label;
    if (same && c->fine && c->count > start + 1) {
        c->count = start + 1;
        c->parts[start].s = *s;
    }
}

/* The size of two shapes' hull over the sum of their sizes; infinite where they are apart. */
static double joined_share(const shape *one, const shape *two, const double *widths)
{
    shape both;
    double lower[2][STATES], upper[2][STATES], box_size = 1;
    bounds_of(one, lower[0], upper[0]), bounds_of(two, lower[1], upper[1]);
    for (int i = 0; i < STATES; ++i) {
        const double least = lesser(lower[0][i], lower[1][i]), most = greater(upper[0][i], upper[1][i]);
        const double gap = greater(lower[0][i], lower[1][i]) - lesser(upper[0][i], upper[1][i]);
        if (gap > 0.05 * (most - least) + 1e-9 * widths[i])
            return INFINITY;
        box_size *= most - least;
    }
    hull(one, two, &both);
    /* slivers may join into slivers */
    return size_of_shape(&both)
        / (size_of_shape(one) + size_of_shape(two) + 1e-6 * box_size + 1e-300);
}

/* Cut a piece at labels, its parts of one label joined where that adds little. */
static int cut(cutting *c, const task *t, const piece *p, const int exact)
{
    double moved[STATES] = {0};
    c->t = t, c->p = p, c->count = 0, c->fine = 1, c->exact = exact;
    for (int i = 0; i < STATES; ++i) {
        c->reach[i] = p->error[i] + t->noise[i];
        if (t->noise[i] > 0)
            c->exact = 0;
    }
    cut_copies(c, 0, &p->s, moved);
    for (int k = 0; k < c->count; ++k)
        for (int l = k + 1; l < c->count; ++l)
            if (c->parts[k].label == c->parts[l].label) {
                if (joined_share(&c->parts[k].s, &c->parts[l].s, t->widths) <= 1.02) {
                    shape both;
                    hull(&c->parts[k].s, &c->parts[l].s, &both);
                    c->parts[k].s = both;
                    c->parts[l] = c->parts[--c->count];
                    l = k;
                }
            }
    return c->fine;
}

/* The cells along an axis that an interval of states meets; 0 where some are none of the grid.
 *
 * States of a piece that are beyond the domain are none, so that its last faces have no beyond. */
static int meets(const task *t, const int axis, const double low, const double high, int64_t *first,
                 int64_t *last)
{
    const double origin = t->grid_lower[axis], end = t->grid_upper[axis], w = t->cell[axis];
    const double a = floor((low - origin) / w - 1e-9), b = floor((high - origin) / w + 1e-9);
    if (!(fabs(a) < 1e9 && fabs(b) < 1e9))
        return 0;
    *first = (int64_t)a, *last = (int64_t)b;
    if (t->periodic[axis] && end - origin >= t->widths[axis])
        return *last - *first < MOST_UNDER;
    if (!t->nearest && origin <= t->lower[axis] && !t->periodic[axis] && *first < 0)
        *first = 0;
    if (!t->nearest && end >= t->upper[axis] && !t->periodic[axis] && *last >= t->counts[axis])
        *last = t->counts[axis] - 1;
    return *first >= 0 && *first <= *last && *last < t->counts[axis];
}

/* Whether all cells under a piece are won in its layer: `bound` gets their largest time, or, where
 * the loop is to stay, they are marked. */
static int over_cells(const task *t, const piece *p, const int mark, double *bound)
{
    double lower[STATES], upper[STATES], out[STATES];
    int64_t first[STATES], last[STATES], at[STATES];
    const int64_t layer = (t->layers > 1 ? p->held : 0) * t->cells;
    int64_t seen = 0;
    bounds_of(&p->s, lower, upper);
    for (int i = 0; i < STATES; ++i)
        out[i] = p->error[i] + 8 * slack(greater(fabs(lower[i]), fabs(upper[i])));
    if (!meets(t, 0, lower[0] - out[0], upper[0] + out[0], first, last))
        return 0;
    for (at[0] = first[0]; at[0] <= last[0]; ++at[0]) { /* a slice of the shape */
        const double a[STATES] = {1}, back[STATES] = {-1};
        const double face = t->grid_lower[0] + t->cell[0] * at[0];
        const double more = out[0] + 8 * slack(face) + 1e-9 * t->cell[0];
        shape below, slice;
        double low[STATES], high[STATES];
        if (!cut_off(&p->s, a, face + t->cell[0] + more, &below)
            || !cut_off(&below, back, more - face, &slice))
            continue;
        bounds_of(&slice, low, high);
        for (int i = 1; i < STATES; ++i) {
            if (!meets(t, i, low[i] - out[i], high[i] + out[i], &first[i], &last[i]))
                return 0;
            at[i] = first[i];
        }
        for (int axis = STATES - 1;;) {
            int64_t cell = 0;
            for (int i = 0; i < STATES; ++i) {
                const int64_t turn = at[i] % t->counts[i];
                cell = cell * t->counts[i] + (turn < 0 ? turn + t->counts[i] : turn);
            }
            if (++seen > MOST_UNDER)
                return 0;
            if (mark)
                t->marks[layer + cell] = 1;
            else {
                const double time = t->bound[layer + cell];
                if (!(time < INFINITY))
                    return 0;
                *bound = greater(*bound, time);
            }
            for (axis = STATES - 1; axis > 0 && ++at[axis] > last[axis]; --axis)
                at[axis] = first[axis];
            if (axis == 0)
                break;
        }
    }
    return 1;
}

/* What is gathered along all pieces from one start. */
typedef struct {
    double bound, lower[STATES], upper[STATES];
    int64_t switches, work;
} gathered;

/* Whether a motion may cross a wall outwards: a rate of 0 keeps it only where it is Lipschitz. */
static int crossed(arguments *a, const box *wall, const int axis, const double sign)
{
    const double rate = most_rate(a, wall, axis, sign);
    double conditions[2][BREAKS][1], out[2][STATES * STATES][1];
    int may = !(rate <= 0);
    put(a, wall);
    BOUNDS(breaks, a, conditions);
    for (int k = 0; k < BREAKS; ++k)
        may |= !(conditions[0][k][0] == conditions[1][k][0]);
    BOUNDS(slopes, a, out);
    for (int j = axis * STATES; rate == 0 && j < (axis + 1) * STATES; ++j)
        may |= !isfinite(out[0][j][0]) || !isfinite(out[1][j][0]);
    return may;
}

/* Let no piece, nor its tube, beyond a face of the domain that no motion crosses outwards; 0 where
 * some may, and where there are no labels beyond, or one is as far out as the domain is wide. */
static int kept_inside(const task *t, arguments *a, piece *p, box *b)
{
    double lower[STATES], upper[STATES];
    for (int i = 0; i < STATES; ++i)
        for (int side = 0; side < 2 && !t->periodic[i]; ++side) {
            bounds_of(&p->s, lower, upper);
            const double sign = side ? 1 : -1, face = side ? t->upper[i] : t->lower[i];
            const double end = sign * (side ? upper[i] : lower[i]) + p->error[i];
            const double beyond = greater(end, sign * (side ? b->upper[i] : b->lower[i]));
            if (beyond <= sign * face)
                continue;
            if (t->nearest) { /* the labels there are those of the nearest cells */
                if (!(beyond <= sign * face + t->widths[i]))
                    return 0;
                continue;
            }
            box wall = *b;
            double normal[STATES] = {0};
            wall.lower[i] = wall.upper[i] = face;
            normal[i] = sign;
            shape inside;
            if (i < MOVING && crossed(a, &wall, i, sign))
                return 0;
            *(side ? &b->upper[i] : &b->lower[i]) = face;
            if (end <= sign * face)
                continue;
            if (!cut_off(&p->s, normal, sign * face + p->error[i] + 4 * slack(face), &inside))
                return 0;
            p->s = inside;
        }
    return 1;
}

static void control(const task *t, arguments *a, const int32_t label)
{
    for (int j = 0; j < CONTROLS; ++j)
        a->ends[0][STATES + j][0] = a->ends[1][STATES + j][0] = t->controls[label * CONTROLS + j];
}

/* Flow under a control for a time; the tube is in `b`. */
static int move(const task *t, arguments *a, const int32_t label, const double time, piece *p,
                box *b)
{
    double avoided[2][1][1];
    control(t, a, label);
    if (!flow(a, t->widths, time, &p->s, p->error, b))
        return UNBOUNDED;
    arguments states = *a;
    put(&states, b);
    BOUNDS(avoid, &states, avoided);
    if (!(avoided[0][0][0] == 0 && avoided[1][0][0] == 0))
        return AVOIDED;
    return kept_inside(t, a, p, b) ? PROVED : LEFT;
}

static void join(box *all, const box *b)
{
    for (int i = 0; i < STATES; ++i) {
        all->lower[i] = lesser(all->lower[i], b->lower[i]);
        all->upper[i] = greater(all->upper[i], b->upper[i]);
    }
}

/* Flow for a number of samples under a label that is decided now; `b` gets the tube. */
static int samples(const task *t, arguments *a, const int32_t label, const int64_t count, piece *p,
                   box *b)
{
    double time = t->sample * count;
    box late;
    int status = PROVED;
    if (t->delay > 0 && p->held != label) {
        status = move(t, a, p->held, t->delay, p, b);
        time -= t->delay;
    } else
        bounds_of(&p->s, b->lower, b->upper);
    if (status == PROVED && time > 0) {
        status = move(t, a, label, time, p, &late);
        join(b, &late);
    }
    p->held = label, p->samples += count;
    return status;
}

/* Whether a state of a box may be measured outside the domain, where the policy has no label. */
static int measured_outside(const task *t, const box *b)
{
    for (int i = 0; i < STATES; ++i)
        if (!t->periodic[i] && !t->nearest && t->noise[i] > 0
            && (b->lower[i] - t->noise[i] < t->lower[i] || b->upper[i] + t->noise[i] > t->upper[i]))
            return 1;
    return 0;
}

/* Whether a policy that holds a label may have no label for a state that is measured in a tube, or
 * another of the same control, which it takes at once, and after which something else follows. */
static int unlabelled(const task *t, const box *b, const int32_t label)
{
    piece p = {.held = label};
    cutting c;
    int none = measured_outside(t, b);
    if (!(GAPS || DRIFTS) || none)
        return none;
    box_shape(b->lower, b->upper, &p.s);
    none = !cut(&c, t, &p, 0);
    for (int k = 0; k < c.count; ++k)
        none |= c.parts[k].label < 0
            || (DRIFTS && c.parts[k].label != label
                && t->kinds[c.parts[k].label] == t->kinds[label]);
    return none;
}

/* Whether a label stays as it is at all states that are measured in a tube. */
static int constant(const task *t, const box *b, const int32_t label)
{
    piece p = {.held = label};
    cutting c;
    box_shape(b->lower, b->upper, &p.s);
    for (int i = 0; i < STATES; ++i) /* a tube is wider than what is in it at samples */
        if (!t->periodic[i] && !t->nearest
            && (b->lower[i] < t->lower[i] || b->upper[i] > t->upper[i]))
            return 0;
    if (measured_outside(t, b) || !cut(&c, t, &p, 0))
        return 0;
    for (int k = 0; k < c.count; ++k)
        if (c.parts[k].label != label)
            return 0;
    return 1;
}

/* Let a part of one label flow until the next decision that may be another. */
static int advance(const task *t, arguments *a, const int32_t label, const int waits, piece *p,
                   gathered *g)
{
    static const int64_t JUMP[] = {64, 16, 4, 1};
    box b, all;
    const int64_t most = t->horizon ? t->horizon - p->samples : INT64_MAX;
    if (waits) { /* no decision changes it meanwhile */
        int64_t left = t->holds[label]; /* longer than a loop is followed, if need be */
        bounds_of(&p->s, all.lower, all.upper);
        while (left > 0) {
            if (*t->stop)
                return TOO_LONG;
            const int64_t count = left < 16 ? left : 16;
            const int status = samples(t, a, label, count, p, &b);
            if (status != PROVED)
                return status;
            if (unlabelled(t, &b, label)) /* it is asked meanwhile */
                return LEFT;
            join(&all, &b);
            left -= count;
        }
    } else
        for (int k = 0; k < 4; ++k) {
            piece moved = *p;
            if (JUMP[k] > most || JUMP[k] > 4 * p->jump)
                continue;
            const int status = samples(t, a, label, JUMP[k], &moved, &all);
            if (status == PROVED && (JUMP[k] == 1 || constant(t, &all, label))) {
                *p = moved;
                p->jump = (int32_t)JUMP[k];
                break;
            }
            if (JUMP[k] == 1)
                return status;
        }
    for (int i = 0; i < STATES && p->samples > t->record; ++i) {
        g->lower[i] = lesser(g->lower[i], all.lower[i]);
        g->upper[i] = greater(g->upper[i], all.upper[i]);
    }
    return PROVED;
}

/* The two as one piece. */
static void merge(piece *p, const piece *q)
{
    shape both;
    double lower[STATES], upper[STATES];
    hull(&p->s, &q->s, &both);
    bounds_of(&both, lower, upper);
    p->s = both;
    p->switches = p->switches > q->switches ? p->switches : q->switches;
    for (int i = 0; i < STATES; ++i)
        p->error[i] = greater(p->error[i], q->error[i])
            + 4 * slack(greater(fabs(lower[i]), fabs(upper[i])));
}

static int alike(const piece *p, const piece *q)
{
    return p->samples == q->samples && p->held == q->held;
}

static void tell(task *t, piece *p)
{
    p->id = (int32_t)t->piece_count++;
    if (t->piece_count > t->piece_room)
        return;
    told_piece *told = t->pieces + p->id;
    memcpy(told->v, p->s.v, sizeof told->v);
    memcpy(told->error, p->error, sizeof told->error);
    told->count = p->s.count, told->held = p->held, told->samples = p->samples;
    told->ended = 0, told->id = p->id, told->merged = -1;
    for (int k = STATES * p->s.count; k < SHAPE_SIZE; ++k)
        told->v[k] = 0; /* a polygon of few vertices */
}

static void told_merged(task *t, const int32_t old, const int32_t new)
{
    if (old < t->piece_room)
        t->pieces[old].merged = new;
}

/* Add a piece to those that are left, joined with those that it fits; 0 where there is no room. */
static int add(task *t, piece *pieces, int *count, piece p)
{
    tell(t, &p);
    for (int k = 0; k < *count; ++k)
        if (alike(&p, pieces + k) && joined_share(&p.s, &pieces[k].s, t->widths) <= 1.05) {
            const int32_t old = p.id, other = pieces[k].id;
            merge(&p, pieces + k);
            tell(t, &p);
            told_merged(t, old, p.id), told_merged(t, other, p.id);
            pieces[k] = pieces[--*count];
            k = -1; /* what it has become may fit others */
        }
    if (*count == MOST_PIECES) {
        double least = 0;
        int one = -1, two = -1;
        for (int k = 0; k < *count; ++k)
            for (int l = k + 1; l < *count; ++l)
                if (alike(pieces + k, pieces + l)) {
                    const double share = joined_share(&pieces[k].s, &pieces[l].s, t->widths);
                    if (one < 0 || share < least)
                        least = share, one = k, two = l;
                }
        if (one < 0)
            return 0;
        const int32_t old = pieces[one].id, other = pieces[two].id;
        merge(pieces + one, pieces + two);
        tell(t, pieces + one);
        told_merged(t, old, pieces[one].id), told_merged(t, other, pieces[one].id);
        pieces[two] = pieces[--*count];
    }
    pieces[(*count)++] = p;
    return 1;
}

static int in_target(const task *t, arguments *a, const piece *p)
{
    double inside[2][1][1];
    box b;
    bounds_of(&p->s, b.lower, b.upper);
    for (int i = 0; i < STATES; ++i)
        b.lower[i] -= p->error[i], b.upper[i] += p->error[i];
    for (int i = 0; i < MOVING; ++i) /* beyond the domain nothing is said of staying */
        if (t->nearest && !t->periodic[i] && (b.lower[i] < t->lower[i] || b.upper[i] > t->upper[i]))
            return 0;
    put(a, &b);
    BOUNDS(target, a, inside);
    return inside[0][0][0] > 0 || inside[1][0][0] < 0;
}

/* Go through the pieces from a box of states with a label in force. */
static int follow(task *t, const double *lower, const double *upper, const int32_t held,
                  const int64_t work, gathered *g)
{
    piece pieces[MOST_PIECES], start = {.held = held, .jump = 16};
    cutting c;
    arguments a;
    int count = 0;
    for (int j = 0; j < PARAMETERS; ++j)
        for (int end = 0; end < 2; ++end)
            a.ends[end][STATES + CONTROLS + j][0] = t->parameters[end * PARAMETERS + j];
    control(t, &a, held);
    box_shape(lower, upper, &start.s);
    g->bound = 0, g->switches = 0, g->work = 0;
    for (int i = 0; i < STATES; ++i) {
        g->lower[i] = t->record ? INFINITY : lower[i];
        g->upper[i] = t->record ? -INFINITY : upper[i];
    }
    add(t, pieces, &count, start);
    while (count) {
        int first = 0;
        for (int k = 1; k < count; ++k)
            if (pieces[k].samples < pieces[first].samples)
                first = k;
        const piece p = pieces[first];
        pieces[first] = pieces[--count];
        if (p.samples) {
            double later = 0;
            const int over = t->horizon ? p.samples >= t->horizon
                                        : in_target(t, &a, &p) || over_cells(t, &p, 0, &later);
            if (over) {
                if (t->horizon && !over_cells(t, &p, 1, &later))
                    return LEFT;
                g->bound = greater(g->bound, t->sample * p.samples + later);
                g->switches = p.switches > g->switches ? p.switches : g->switches;
                if (p.id < t->piece_room)
                    t->pieces[p.id].ended = 1;
                continue;
            }
        }
        if (++g->work > work || *t->stop)
            return TOO_LONG;
        box where;
        bounds_of(&p.s, where.lower, where.upper);
        for (int i = 0; i < STATES; ++i)
            where.lower[i] -= p.error[i], where.upper[i] += p.error[i];
        if (measured_outside(t, &where))
            return LEFT;
        if (!cut(&c, t, &p, p.samples == 0))
            return TOO_MANY;
        for (int k = 0; k < c.count; ++k) {
            const int32_t label = c.parts[k].label;
            if (label < 0)
                return LEFT; /* a gap */
            const int change = t->kinds[label] != t->kinds[p.held];
            /* a loop that begins has the default in force, and holds what it takes first: the same
             * label may be held then, or not */
            const int begins = p.samples == 0 && p.held == LABELS - 1 && !change;
            const int ways = begins && t->holds[label] > 1 ? 2 : 1;
            for (int way = 0; way < ways; ++way) {
                piece q = p;
                q.s = c.parts[k].s;
                q.switches += change && p.samples >= t->record;
                for (int i = 0; i < STATES; ++i)
                    q.error[i] += 4 * slack(greater(fabs(where.lower[i]), fabs(where.upper[i])));
                const piece from = q;
                const int hold = t->holds[label] > 1 && (change || way);
                const int status = advance(t, &a, label, hold, &q, g);
                if (status != PROVED)
                    return status;
                if (t->flow_count < t->flow_room) {
                    told_flow *f = t->flows + t->flow_count;
                    memcpy(f->v, from.s.v, sizeof f->v);
                    memcpy(f->error, from.error, sizeof f->error);
                    f->count = from.s.count, f->label = label, f->samples = q.samples - p.samples;
                    f->start = p.id, f->end = (int32_t)t->piece_count, f->waits = hold;
                }
                ++t->flow_count;
                if (!add(t, pieces, &count, q))
                    return TOO_MANY;
            }
        }
    }
    return PROVED;
}

/* Follow boxes (count x STATES ends each) with labels in force, each by at most so many flows;
 * what comes of each. */
void capsyn_follow(const int64_t count, task *t, const double *lower, const double *upper,
                   const int32_t *held, const int64_t *most, int32_t *status, double *bound, double *extents,
                   int64_t *switches, int64_t *work, int64_t *told)
{
    for (int64_t k = 0; k < count; ++k) {
        gathered g;
        const int64_t pieces = t->piece_count, flows = t->flow_count;
        status[k] = follow(t, lower + k * STATES, upper + k * STATES, held[k], most[k], &g);
        bound[k] = g.bound, switches[k] = g.switches, work[k] = g.work;
        memcpy(extents + 2 * STATES * k, g.lower, sizeof g.lower);
        memcpy(extents + 2 * STATES * k + STATES, g.upper, sizeof g.upper);
        if (status[k] != PROVED)
            t->piece_count = pieces, t->flow_count = flows;
        told[2 * k] = t->piece_count, told[2 * k + 1] = t->flow_count;
    }
}
