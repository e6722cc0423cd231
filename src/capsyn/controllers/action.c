/* One whole action of sSAC or SAC (Section III-A of the paper) for each state.
 *
 * Needs lookup.c, STATES, INPUTS, SYMBOLS, SAC, and the programs step_one, adjoint_one and
 * terminal_cost_one for one lane, step, terminal_cost and insertion (or sac) for LANES. The
 * prediction is one lane; times of the schedule, and the costs of the line search, are lanes.
 * `online.py` says what happens, `actions.py` does the same in NumPy.
 */
enum { NONE = -2 };
#define PAIRS (LANES / 2)

typedef struct {
    double cost, decrease, gradient, time, start, duration, control[INPUTS], base[INPUTS];
    int64_t symbol, base_symbol;
} action; /* `action_type` in kernels.py */

typedef struct {
    double horizon, gamma, alpha_d, initial, shrink, descent, exponent, tie, rounding;
    int64_t steps, search, steepest, to_default, backtracks, outside, lost;
    int64_t gap;                    /* the label of cells that are outside, or -1 */
    const double *values, *efforts; /* (SYMBOLS, INPUTS) and (SYMBOLS) */
    const int64_t *preference;      /* (SYMBOLS + 1) */
    const double *feed;             /* default controls (steps, INPUTS), or of a policy: */
    const double *table;            /* (symbols + 1, INPUTS) */
    const int32_t *transitions;     /* (rows, symbols + 1), or NULL where rows are labels */
    tree cells;
} options;

typedef struct {
    double x[STATES][1], rho[STATES][1], u[INPUTS][1];
} moment;

#if !SAC
/* The symbol that a policy would have for these gradients, see BatchController.possible. */
static int choose(const options *o, const double wanted, const double *gradient,
                  const double *scale)
{
    double low[SYMBOLS], least = INFINITY;
    int could[SYMBOLS + 1];
    for (int i = 0; i < SYMBOLS; ++i) {
        const double margin = o->tie * scale[i];
        double high;
        if (o->steepest) {
            low[i] = gradient[i] - margin;
            high = gradient[i] + margin;
        } else {
            const double distance = fabs(gradient[i] - wanted);
            const double nearest = fmax(distance - margin, 0);
            low[i] = nearest * nearest;
            high = (distance + margin) * (distance + margin);
        }
        low[i] += o->efforts[i];
        high += o->efforts[i];
        if (!isfinite(high))
            return SYMBOLS;
        least = fmin(least, high);
    }
    could[SYMBOLS] = 0;
    for (int i = 0; i < SYMBOLS; ++i) {
        could[i] = low[i] <= least;
        if (o->to_default && could[i]) {
            const double margin = o->tie * scale[i];
            could[SYMBOLS] |= gradient[i] + margin >= 0;
            could[i] = gradient[i] - margin < 0;
        }
    }
    for (int i = 0; i <= SYMBOLS; ++i)
        if (could[o->preference[i]])
            return (int)o->preference[i];
    return SYMBOLS;
}
#endif

/* Controls, gradients and symbols of the schedule at sample times first .. first + LANES - 1. */
static void schedule(const options *o, const moment *path, const int64_t first, const double cost,
                     double control[INPUTS][LANES], double gradient[LANES], int64_t symbol[LANES])
{
    _Alignas(64) double x[STATES][LANES], rho[STATES][LANES], u[INPUTS][LANES];
    const double wanted = isnan(o->alpha_d) ? o->gamma * cost : o->alpha_d;
    for (int lane = 0; lane < LANES; ++lane) {
        const int64_t k = first + lane < o->steps ? first + lane : o->steps;
        for (int i = 0; i < STATES; ++i) {
            x[i][lane] = path[k].x[i][0];
            rho[i][lane] = path[k].rho[i][0];
        }
        for (int i = 0; i < INPUTS; ++i)
            u[i][lane] = path[k].u[i][0];
    }
#if SAC
    double alpha[1] = {wanted};
    sac(x, u, rho, alpha, control, (double(*)[LANES])gradient);
    for (int lane = 0; lane < LANES; ++lane)
        symbol[lane] = NONE;
#else
    _Alignas(64) double total[1][LANES], gradients[SYMBOLS][LANES], scales[SYMBOLS][LANES];
    double noise[1] = {o->rounding}, one[SYMBOLS], size[SYMBOLS];
    for (int lane = 0; lane < LANES; ++lane)
        total[0][lane] = cost;
    insertion(x, u, rho, total, noise, gradients, scales);
    for (int lane = 0; lane < LANES; ++lane) {
        for (int i = 0; i < SYMBOLS; ++i) {
            one[i] = gradients[i][lane];
            size[i] = scales[i][lane];
        }
        const int best = choose(o, wanted, one, size);
        symbol[lane] = best == SYMBOLS ? -1 : best;
        gradient[lane] = best == SYMBOLS ? 0 : one[best];
        for (int i = 0; i < INPUTS; ++i)
            control[i][lane] = best == SYMBOLS ? u[i][lane] : o->values[best * INPUTS + i];
    }
#endif
}

/* Costs of acting in the windows [start, stop), and of not acting, on the same grids: PAIRS each. */
static void costs(const options *o, const moment *path, const double *control,
                  const double *start, const double *stop, double acting[PAIRS],
                  double idle[PAIRS])
{
    _Alignas(64) double x[2][STATES][LANES], u[INPUTS][LANES], h[1][LANES], part[1][LANES];
    _Alignas(64) double total[LANES], gradient[STATES][LANES];
    double time[PAIRS];
    int64_t base[PAIRS];
    const double dt = o->horizon / (double)o->steps;
    for (int lane = 0; lane < LANES; ++lane) {
        for (int i = 0; i < STATES; ++i)
            x[0][i][lane] = path[0].x[i][0];
        total[lane] = 0;
    }
    for (int pair = 0; pair < PAIRS; ++pair) {
        time[pair] = 0;
        base[pair] = 0;
    }
    int from = 0;
    for (int64_t s = 0; s < o->steps + 2; ++s, from = !from) {
        for (int pair = 0; pair < PAIRS; ++pair) {
            const double now = time[pair];
            const int64_t k = base[pair] < o->steps ? base[pair] : o->steps - 1;
            double next = base[pair] < o->steps ? (double)(k + 1) * dt : now;
            const double whole = next;
            if (now < start[pair] && start[pair] < next)
                next = start[pair];
            if (now < stop[pair] && stop[pair] < next)
                next = stop[pair];
            const int acts = now >= start[pair] && now < stop[pair];
            for (int i = 0; i < INPUTS; ++i) {
                u[i][pair] = acts ? control[i] : path[k].u[i][0];
                u[i][PAIRS + pair] = path[k].u[i][0];
            }
            h[0][pair] = h[0][PAIRS + pair] = next - now;
            base[pair] += next == whole;
            time[pair] = next;
        }
        step(x[from], u, h, x[!from], part);
        EACH_LANE {
            total[lane] += part[0][lane];
        }
    }
    terminal_cost(x[from], part, gradient);
    for (int pair = 0; pair < PAIRS; ++pair) {
        acting[pair] = total[pair] + part[0][pair];
        idle[pair] = total[PAIRS + pair] + part[0][PAIRS + pair];
    }
}

/* The longest of the durations that takes off enough, else the shortest if it takes off any. */
static void search(const options *o, const moment *path, action *a)
{
    double width = o->initial;
    for (int64_t first = 0; first <= o->backtracks; first += PAIRS) {
        double start[PAIRS], stop[PAIRS], acting[PAIRS], idle[PAIRS];
        for (int pair = 0; pair < PAIRS; ++pair, width *= o->shrink) {
            start[pair] = fmax(a->time - width, 0);
            stop[pair] = fmin(a->time + width, o->horizon);
        }
        costs(o, path, a->control, start, stop, acting, idle);
        for (int pair = 0; pair < PAIRS && first + pair <= o->backtracks; ++pair) {
            const int last = first + pair == o->backtracks;
            const double wanted = last ? 0 : o->descent * fabs(idle[pair]);
            if (acting[pair] < idle[pair] - wanted) {
                a->start = start[pair];
                a->duration = stop[pair] - start[pair];
                a->decrease = idle[pair] - acting[pair];
                return;
            }
        }
    }
}

/* Actions of `count` states (count, STATES); schedules (count, steps + 1, INPUTS) may be NULL. */
int capsyn_action(const int64_t count, const double *restrict states, const options *settings,
                  action *restrict actions, double *restrict schedules)
{
    const options o = *settings;
    const double dt[1] = {o.horizon / (double)o.steps};
    measures m = {0};
    if (o.table)
        m = measure(&o.cells);
    moment *path = malloc(sizeof(moment) * ((size_t)o.steps + 1));
    if (path == NULL)
        return -1;
    for (int64_t b = 0; b < count; ++b) {
        action *a = actions + b;
        double total = 0, part[1][1];
        int64_t now = o.lost; /* in force along the prediction: at first the default */
        a->base_symbol = -1;
        for (int i = 0; i < STATES; ++i)
            path[0].x[i][0] = states[b * STATES + i];
        for (int64_t k = 0; k < o.steps; ++k) {
            const double *u = o.feed ? o.feed + k * INPUTS : NULL;
            if (u == NULL) {
                int outside;
                int64_t label =
                    nearest_label(&o.cells, &m, path[k].x[0], (int32_t)now, &outside);
                if (o.transitions && label >= 0)
                    label = o.transitions[label * (o.lost + 1) + now];
                if ((outside || label == NOT_FINITE || label == o.gap) && o.outside >= 0)
                    label = o.outside;
                else if (label == NOT_FINITE)
                    label = o.lost;
                u = o.table + label * INPUTS;
                now = label;
                if (k == 0)
                    a->base_symbol = label == o.lost ? -1 : label;
            }
            for (int i = 0; i < INPUTS; ++i)
                path[k].u[i][0] = u[i];
            step_one(path[k].x, path[k].u, dt, path[k + 1].x, part);
            total += part[0][0];
        }
        for (int i = 0; i < INPUTS; ++i)
            path[o.steps].u[i][0] = path[o.steps - 1].u[i][0];
        terminal_cost_one(path[o.steps].x, part, path[o.steps].rho);
        total += part[0][0];
        for (int64_t k = o.steps - 1; k >= 0; --k)
            adjoint_one(path[k].x, path[k].u, dt, path[k + 1].rho, path[k].rho);

        double best = INFINITY;
        a->cost = total;
        a->decrease = a->gradient = a->time = a->duration = a->start = 0;
        a->symbol = -1;
        for (int i = 0; i < INPUTS; ++i)
            a->control[i] = a->base[i] = path[0].u[i][0];
        const int64_t last = o.search || schedules ? o.steps : 0;
        for (int64_t first = 0; first <= last; first += LANES) {
            _Alignas(64) double control[INPUTS][LANES], gradient[LANES];
            int64_t symbol[LANES];
            schedule(&o, path, first, total, control, gradient, symbol);
            for (int lane = 0; lane < LANES && first + lane <= last; ++lane) {
                const int64_t k = first + lane;
                double effort = 0;
                for (int i = 0; i < INPUTS; ++i)
                    effort += control[i][lane] * control[i][lane];
                const double time = (double)k * dt[0];
                const double value = sqrt(effort) + gradient[lane] + pow(time, o.exponent);
                if (schedules)
                    for (int i = 0; i < INPUTS; ++i)
                        schedules[(b * (o.steps + 1) + k) * INPUTS + i] = control[i][lane];
                if (o.search ? value < best : k == 0) {
                    best = value;
                    a->time = time;
                    a->gradient = gradient[lane];
                    a->symbol = symbol[lane];
                    for (int i = 0; i < INPUTS; ++i)
                        a->control[i] = control[i][lane];
                }
            }
        }
        if (isfinite(total) && a->gradient < 0)
            search(&o, path, a);
    }
    free(path);
    return 0;
}
