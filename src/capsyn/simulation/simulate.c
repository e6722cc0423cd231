/* The closed loop of a policy and a plant at a sample rate, for blocks of LANES trials.
 *
 * Needs lookup.c, STATES, INPUTS, PARAMETERS, QUEUE, DISCRETE (whether the dynamics are a map) and
 * the programs dynamics, running_cost and inside before it, and -ffp-contract=off. With CHOOSES, the
 * symbol comes not from the cells but from what stands in choose.c, before it.
 * `closed_loop.py` says what happens at a sample, and does the same in NumPy. Trials do not see
 * each other, and each goes through the same instructions whatever its place, so that results do
 * not depend on how trials are grouped.
 */
enum { NONE = -2, RUNNING = 0, ARRIVED = 1, LEFT_DOMAIN = 2, NOT_A_STATE = 3 };

typedef struct {
    double state[STATES], push[STATES], cost, rest, effort, fuel;
#if PARAMETERS
    double parameters[PARAMETERS];
#endif
    double control[INPUTS], queue[QUEUE][INPUTS];
    int64_t delay, symbol, held, switches, outside, ended, end, arrived, away, alphabet;
    int64_t held_inputs[INPUTS];
} trial;

typedef struct {
    double period;
    int64_t substeps, last, outside_error, outside_symbol, stop, symbols, outside_at_once;
    const double *controls; /* (symbols + 1, INPUTS), the default last */
    const int64_t *holds;   /* (symbols + 1): samples that each is held once entered */
    const int64_t *inputs;  /* (INPUTS): samples that each is held once changed, or NULL */
    const int64_t *kinds;   /* (symbols + 1), equal where a change is no switch */
    const uint8_t *forbidden;   /* (symbols + 1, symbols + 1), from each to each */
    const int32_t *transitions; /* (rows, symbols + 1), or NULL where rows are labels */
    int64_t gap;                /* the label of cells that are outside, or -1 */
    int64_t exogenous;          /* how many of the STATES are exogenous inputs, the last ones */
    const double *told;         /* (last + 1, exogenous), NaN where one stays, or NULL */
    const double *paid;         /* (symbols + 1, symbols + 1), from each to each, or NULL */
    tree cells;
} loop;

typedef double lanes_of_states[STATES][LANES];
typedef double lanes_of_inputs[INPUTS][LANES];
typedef double lanes[LANES];

typedef struct {
    lanes_of_states x, push;
    lanes cost;
#if PARAMETERS
    double parameters[PARAMETERS][LANES];
#endif
} block;

static inline void slope(const block *b, const lanes_of_states x, const lanes_of_inputs u,
                         lanes_of_states out, double cost[1][LANES])
{
#if PARAMETERS
    dynamics(x, u, b->parameters, out);
#else
    dynamics(x, u, out);
#endif
    running_cost(x, cost);
    for (int i = 0; i < STATES; ++i)
        EACH_LANE {
            out[i][lane] += b->push[i][lane];
        }
}

#if DISCRETE
/* So many samples of the map, in every lane whose duration is not 0. */
static void advance(block *b, const lanes_of_inputs u, const lanes duration, const int64_t samples)
{
    _Alignas(64) lanes_of_states next;
    _Alignas(64) double cost[1][LANES];
    for (int64_t s = 0; s < samples; ++s) {
        slope(b, b->x, u, next, cost);
        for (int i = 0; i < STATES; ++i)
            EACH_LANE {
                b->x[i][lane] = duration[lane] > 0 ? next[i][lane] : b->x[i][lane];
            }
        EACH_LANE {
            b->cost[lane] += duration[lane] > 0 ? cost[0][lane] : 0.0;
        }
    }
}
#else
static inline void along(const lanes_of_states x, const lanes_of_states k, const lanes h,
                         const double factor, lanes_of_states out)
{
    for (int i = 0; i < STATES; ++i)
        EACH_LANE {
            out[i][lane] = x[i][lane] + factor * h[lane] * k[i][lane];
        }
}

/* The classical Runge-Kutta method over a duration of its own in every lane. */
static void advance(block *b, const lanes_of_inputs u, const lanes duration, const int64_t substeps)
{
    _Alignas(64) lanes_of_states k1, k2, k3, k4, y;
    _Alignas(64) double c1[1][LANES], c2[1][LANES], c3[1][LANES], c4[1][LANES];
    _Alignas(64) lanes h;
    EACH_LANE {
        h[lane] = duration[lane] / (double)substeps;
    }
    for (int64_t s = 0; s < substeps; ++s) {
        slope(b, b->x, u, k1, c1);
        along(b->x, k1, h, 0.5, y);
        slope(b, y, u, k2, c2);
        along(b->x, k2, h, 0.5, y);
        slope(b, y, u, k3, c3);
        along(b->x, k3, h, 1.0, y);
        slope(b, y, u, k4, c4);
        for (int i = 0; i < STATES; ++i)
            EACH_LANE {
                b->x[i][lane] += h[lane] / 6 *
                    (k1[i][lane] + 2 * k2[i][lane] + 2 * k3[i][lane] + k4[i][lane]);
            }
        EACH_LANE {
            b->cost[lane] += h[lane] / 6 *
                (c1[0][lane] + 2 * c2[0][lane] + 2 * c3[0][lane] + c4[0][lane]);
        }
    }
}

#endif

/* The label that is taken while `now` is in force and another is wanted: that, or `now` while it is
 * held, or, while some inputs are held, the first with their values and else those that are wanted. */
static int64_t permitted(const trial *t, const loop *l, const int64_t now, const int64_t wanted)
{
    const double *own = l->controls + now * INPUTS, *other = l->controls + wanted * INPUTS;
    double u[INPUTS];
    int locked = 0, moves = 0;
    if (t->held < l->holds[now] || l->forbidden[now * (l->symbols + 1) + wanted])
        return now;
    if (!l->inputs)
        return wanted;
    for (int i = 0; i < INPUTS; ++i) {
        const int lock = t->held_inputs[i] < l->inputs[i];
        locked |= lock && own[i] != other[i];
        u[i] = lock ? own[i] : other[i];
        moves |= u[i] != own[i];
    }
    if (!locked)
        return wanted;
    for (int64_t s = 0; moves && s < l->symbols; ++s) {
        int same = !l->forbidden[now * (l->symbols + 1) + s];
        for (int i = 0; i < INPUTS; ++i)
            same &= l->controls[s * INPUTS + i] == u[i];
        if (same)
            return s;
    }
    return now;
}

/* Take the label that is wanted, if it is permitted or does not wait. */
static void take(trial *t, const loop *l, int64_t wanted, const int at_once)
{
    const int64_t now = t->symbol;
    if (now != NONE && !at_once && l->kinds[wanted] != l->kinds[now])
        wanted = permitted(t, l, now, wanted);
    const double *u = l->controls + wanted * INPUTS;
    if (now == NONE || l->kinds[wanted] != l->kinds[now]) {
        t->switches += now != NONE;
        t->held = 0;
    }
    ++t->held;
    for (int i = 0; i < INPUTS; ++i) {
        t->held_inputs[i] = now == NONE || u[i] != t->control[i] ? 1 : t->held_inputs[i] + 1;
        t->control[i] = u[i];
    }
    t->symbol = wanted;
}

/* What a trial does at sample k: end, or take a new control into its queue; that of the symbol
 * `chosen` where it is one. */
static void sample(trial *t, const loop *l, const measures *m, const int64_t k,
                   const double *noise, const int target, const int64_t chosen)
{
    for (int i = 0; i < STATES; ++i)
        if (!isfinite(t->state[i]))
            t->ended = NOT_A_STATE;
    if (t->ended == RUNNING && target) {
        if (t->arrived < 0)
            t->arrived = k;
        if (l->stop)
            t->ended = ARRIVED;
    } else {
        t->away = k;
    }
    if (t->ended == RUNNING && k < l->last) {
        double measured[STATES];
        int outside;
        for (int i = 0; i < STATES; ++i)
            measured[i] = t->state[i] + (noise ? noise[i] : 0.0);
        const int64_t now = t->symbol == NONE ? l->symbols : t->symbol;
        int64_t symbol = nearest_label(&l->cells, m, measured, (int32_t)now, &outside);
        if (chosen >= 0 && symbol >= 0)
            symbol = chosen;
        else if (l->transitions && symbol >= 0)
            symbol = l->transitions[symbol * (l->symbols + 1) + now];
        const int lost = symbol == l->gap; /* in a gap; there is no nearest symbol */
        outside |= symbol == NOT_FINITE || lost;
        t->outside += outside;
        if (outside && (l->outside_error || (lost && l->outside_symbol < 0)))
            t->ended = symbol == NOT_FINITE ? NOT_A_STATE : LEFT_DOMAIN;
        else if (symbol == NOT_FINITE && l->outside_symbol < 0)
            t->ended = NOT_A_STATE;
        else {
            const int at_once = symbol == NOT_FINITE || (outside && l->outside_at_once);
            if (outside && l->outside_symbol >= 0)
                symbol = l->outside_symbol;
            take(t, l, symbol, at_once);
            for (int i = 0; i < INPUTS; ++i)
                t->queue[k % QUEUE][i] = t->control[i];
        }
    }
    if (t->ended != RUNNING || k == l->last)
        t->end = k;
}

/* Gather what a control costs over a time: u^T u, and the sum of |u|. */
static void spend(trial *t, const double *u, const double time)
{
    double square = 0, sum = 0;
    for (int i = 0; i < INPUTS; ++i) {
        square += u[i] * u[i];
        sum += fabs(u[i]);
    }
    t->effort += square * time;
    t->fuel += sum * time;
}

/* Run samples first .. first + samples - 1 of the trials, and sample `last` too where it is next.
 *
 * noise (count, samples, STATES), pushes (samples, STATES), states (count, last + 1, STATES),
 * symbols (count, last) and costs (count, last + 1) may be NULL. `choices` are those of choose.c.
 */
void capsyn_simulate(const int64_t count, trial *restrict trials, const int64_t first,
                     const int64_t samples, const loop *settings, const double *restrict noise,
                     const double *restrict pushes, double *restrict states,
                     int64_t *restrict symbols, double *restrict costs, const void *choices)
{
    const loop l = *settings;
    const measures m = measure(&l.cells);
    const double *idle = l.controls + l.symbols * INPUTS;
#if CHOOSES
    room space;
    if (!make_room(&space, choices))
        abort();
#endif

    for (int64_t start = 0; start < count; start += LANES) {
        const int used = count - start < LANES ? (int)(count - start) : LANES;
        trial *t = trials + start;
        _Alignas(64) block b;
        _Alignas(64) lanes_of_inputs late, now;
        _Alignas(64) lanes late_time, now_time;
        _Alignas(64) double target[1][LANES];
        int any_late = 0;
        for (int lane = 0; lane < LANES; ++lane) {
            const trial *from = t + (lane < used ? lane : used - 1);
            for (int i = 0; i < STATES; ++i)
                b.x[i][lane] = from->state[i];
            b.cost[lane] = from->cost;
#if PARAMETERS
            for (int i = 0; i < PARAMETERS; ++i)
                b.parameters[i][lane] = from->parameters[i];
#endif
            now_time[lane] = l.period - from->rest;
            late_time[lane] = l.period - now_time[lane]; /* the sum is the period, rounded or not */
            any_late |= from->rest > 0;
        }
        for (int64_t k = first; k < first + samples + (first + samples == l.last); ++k) {
            int running = 0;
            for (int64_t i = 0; l.told && i < l.exogenous; ++i) {
                const double value = l.told[k * l.exogenous + i];
                if (value == value)
                    for (int lane = 0; lane < LANES; ++lane)
                        b.x[STATES - l.exogenous + i][lane] = value;
            }
            inside(b.x, target);
            int64_t chosen[LANES] = {0};
#if CHOOSES
            if (k < l.last) {
                int64_t now[LANES], alphabets[LANES];
                for (int lane = 0; lane < LANES; ++lane) {
                    const int own = lane < used ? lane : used - 1;
                    const double *off =
                        noise ? noise + ((start + own) * samples + (k - first)) * STATES : NULL;
                    for (int i = 0; i < STATES; ++i)
                        space.measured[i][lane] = b.x[i][lane] + (off ? off[i] : 0.0);
                    now[lane] = t[own].symbol == NONE ? l.symbols : t[own].symbol;
                    alphabets[lane] = t[own].alphabet;
                }
                choose(&space, choices, &l.cells, l.controls, l.symbols, alphabets, now, chosen);
            }
#endif
            for (int lane = 0; lane < used; ++lane) {
                trial *one = t + lane;
                if (one->ended != RUNNING || one->end >= 0)
                    continue;
                for (int i = 0; i < STATES; ++i)
                    one->state[i] = b.x[i][lane];
                one->cost = b.cost[lane];
                const int64_t label = one->symbol == NONE ? l.symbols : one->symbol;
                const double *own_noise =
                    noise ? noise + ((start + lane) * samples + (k - first)) * STATES : NULL;
                sample(one, &l, &m, k, k < l.last ? own_noise : NULL,
                       target[0][lane] != 0 && isfinite(target[0][lane]),
                       CHOOSES ? chosen[lane] : -1);
                if (states)
                    for (int i = 0; i < STATES; ++i)
                        states[((start + lane) * (l.last + 1) + k) * STATES + i] = one->state[i];
                if (costs)
                    costs[(start + lane) * (l.last + 1) + k] = one->cost;
                if (one->end >= 0)
                    continue;
                if (l.paid)
                    b.cost[lane] += l.paid[label * (l.symbols + 1) + one->symbol];
                if (symbols)
                    symbols[(start + lane) * l.last + k] = one->symbol;
#if CHOOSES
                count_use(choices, start + lane, one->alphabet, one->symbol);
#endif
                running = 1;
                const double *before =
                    k - one->delay - 1 >= 0 ? one->queue[(k - one->delay - 1) % QUEUE] : idle;
                const double *after =
                    k - one->delay >= 0 ? one->queue[(k - one->delay) % QUEUE] : idle;
                for (int i = 0; i < INPUTS; ++i) {
                    late[i][lane] = before[i];
                    now[i][lane] = after[i];
                }
                spend(one, before, late_time[lane]);
                spend(one, after, now_time[lane]);
            }
            if (!running)
                break;
            for (int lane = 0; lane < LANES; ++lane) {
                const trial *from = t + (lane < used ? lane : used - 1);
                for (int i = 0; i < STATES; ++i)
                    b.push[i][lane] = from->push[i] + (pushes ? pushes[(k - first) * STATES + i] : 0);
                if (lane >= used || t[lane].end >= 0)
                    for (int i = 0; i < INPUTS; ++i)
                        late[i][lane] = now[i][lane] = idle[i];
            }
            if (any_late)
                advance(&b, late, late_time, l.substeps);
            advance(&b, now, now_time, l.substeps);
        }
        for (int lane = 0; lane < used; ++lane)
            if (t[lane].end < 0) {
                for (int i = 0; i < STATES; ++i)
                    t[lane].state[i] = b.x[i][lane];
                t[lane].cost = b.cost[lane];
            }
    }
#if CHOOSES
    free(space.memory);
#endif
}
