/* Dynamic programming over symbols on a grid of states: what each symbol leads to, and sweeps.
 *
 * Needs AXES, INPUTS, LANES, DISCRETE (whether the dynamics are a map) and the programs dynamics,
 * running_cost and inside before it. States are handled in blocks of LANES; of each block and symbol
 * there are entries of values, weights between them and costs, so that a sweep reads them in order.
 * `numpy_sweeps.py` does the same.
 */
#define CORNERS (1 << AXES)
#define HUGE_COST 1e30

typedef double lanes_of_states[AXES][LANES];
typedef double lanes[LANES];

typedef struct {
    const double *lower, *scale; /* (AXES): first node [state units], intervals per state unit */
    const int64_t *counts, *periodic; /* (AXES): intervals, and whether it is periodic */
    int64_t nothing;             /* first of the entries of values that stay 0 */
    const double *controls, *efforts; /* (symbols, INPUTS), and cost of each [cost / time unit] */
    double step;                 /* [time unit] of Runge-Kutta */
    int64_t steps, symbols;
    const int64_t *samples;      /* (symbols): that each is held; a loop may end at each */
} lattice;

static void slope(const lanes_of_states x, const double u[INPUTS][LANES], lanes_of_states rates,
                  double cost[1][LANES])
{
    dynamics(x, u, rates);
    running_cost(x, cost);
}

#if DISCRETE
/* The samples of the map, in place; the cost that they gather. */
static void advance(const lattice *g, lanes_of_states x, const double u[INPUTS][LANES], lanes total)
{
    _Alignas(64) lanes_of_states next;
    _Alignas(64) double cost[1][LANES];
    EACH_LANE {
        total[lane] = 0;
    }
    for (int64_t s = 0; s < g->steps; ++s) {
        slope(x, u, next, cost);
        for (int i = 0; i < AXES; ++i)
            EACH_LANE {
                x[i][lane] = next[i][lane];
            }
        EACH_LANE {
            total[lane] += cost[0][lane];
        }
    }
}
#else
static inline void along(const lanes_of_states x, const lanes_of_states k, const double h,
                         lanes_of_states out)
{
    for (int i = 0; i < AXES; ++i)
        EACH_LANE {
            out[i][lane] = x[i][lane] + h * k[i][lane];
        }
}

/* The classical Runge-Kutta method over a sample, in place; the cost that it gathers. */
static void advance(const lattice *g, lanes_of_states x, const double u[INPUTS][LANES], lanes total)
{
    _Alignas(64) lanes_of_states k1, k2, k3, k4, y;
    _Alignas(64) double c1[1][LANES], c2[1][LANES], c3[1][LANES], c4[1][LANES];
    const double h = g->step;
    EACH_LANE {
        total[lane] = 0;
    }
    for (int64_t s = 0; s < g->steps; ++s) {
        slope(x, u, k1, c1);
        along(x, k1, 0.5 * h, y);
        slope(y, u, k2, c2);
        along(x, k2, 0.5 * h, y);
        slope(y, u, k3, c3);
        along(x, k3, h, y);
        slope(y, u, k4, c4);
        for (int i = 0; i < AXES; ++i)
            EACH_LANE {
                x[i][lane] += h / 6 * (k1[i][lane] + 2 * k2[i][lane] + 2 * k3[i][lane] + k4[i][lane]);
            }
        EACH_LANE {
            total[lane] += h / 6 * (c1[0][lane] + 2 * c2[0][lane] + 2 * c3[0][lane] + c4[0][lane]);
        }
    }
}

#endif

/* Load a block of states (count, AXES); what is missing is its last. */
static int load_block(const int64_t count, const double *states, const int64_t start,
                      lanes_of_states x)
{
    const int used = count - start < LANES ? (int)(count - start) : LANES;
    for (int lane = 0; lane < LANES; ++lane)
        for (int i = 0; i < AXES; ++i)
            x[i][lane] = states[(start + (lane < used ? lane : used - 1)) * AXES + i];
    return used;
}

/* Between which entries of values states are; beyond the grid they count as at its face. */
static void locate(const lattice *g, const lanes_of_states x, int32_t *restrict at,
                   float (*restrict weight)[LANES])
{
    _Alignas(64) lanes place;
    EACH_LANE {
        place[lane] = 0;
    }
    for (int i = 0; i < AXES; ++i) {
        const double count = (double)g->counts[i], low = g->lower[i], scale = g->scale[i];
        const double wrap = g->periodic[i] ? count : 0.0;
        EACH_LANE {
            double c = (x[i][lane] - low) * scale;
            c -= wrap * floor(c / count);
            c = c > 0 ? c : 0; /* as is a NaN */
            c = c < count ? c : count;
            double k = floor(c);
            k = k < count - 1 ? k : count - 1;
            weight[i][lane] = (float)(c - k);
            place[lane] = place[lane] * (count + 1) + k;
        }
    }
    EACH_LANE {
        at[lane] = (int32_t)place[lane];
    }
}

/* Whether each state of a block is in the target. */
static void arrived(const lanes_of_states x, int out[LANES])
{
    _Alignas(64) double condition[1][LANES];
    inside(x, condition);
    for (int lane = 0; lane < LANES; ++lane)
        out[lane] = condition[0][lane] != 0 && isfinite(condition[0][lane]);
}

/* What every symbol leads to over some samples from a block of states: at (symbols, LANES), weights
 * (symbols, AXES, LANES) and costs (symbols, LANES). */
static void lead(const lattice *g, const lanes_of_states first, int32_t *restrict at,
                 float *restrict weights, float *restrict costs)
{
    _Alignas(64) lanes_of_states x;
    _Alignas(64) double u[INPUTS][LANES];
    _Alignas(64) lanes total;
    int begun[LANES], ended[LANES], now[LANES];
    arrived(first, begun);
    for (int64_t s = 0; s < g->symbols; ++s) {
        double sum[LANES] = {0};
        const double effort = g->efforts[s] * (g->step * (double)g->steps);
        for (int i = 0; i < AXES; ++i)
            EACH_LANE {
                x[i][lane] = first[i][lane];
            }
        for (int i = 0; i < INPUTS; ++i)
            EACH_LANE {
                u[i][lane] = g->controls[s * INPUTS + i];
            }
        for (int lane = 0; lane < LANES; ++lane)
            ended[lane] = begun[lane];
        for (int64_t k = 0; k < g->samples[s]; ++k) {
            advance(g, x, u, total);
            arrived(x, now);
            for (int lane = 0; lane < LANES; ++lane) {
                sum[lane] += ended[lane] ? 0 : total[lane] + effort;
                ended[lane] |= now[lane];
            }
        }
        locate(g, x, at, (float (*)[LANES])weights);
        for (int lane = 0; lane < LANES; ++lane) {
            int finite = isfinite(sum[lane]);
            for (int i = 0; i < AXES; ++i)
                finite &= isfinite(x[i][lane]) != 0;
            if (ended[lane])
                at[lane] = (int32_t)g->nothing;
            costs[lane] = begun[lane] ? 0.0f
                : (finite || ended[lane]) && sum[lane] < HUGE_COST ? (float)sum[lane]
                : (float)HUGE_COST;
        }
        at += LANES;
        weights += AXES * LANES;
        costs += LANES;
    }
}

/* What every symbol leads to: the same of states (count, AXES), block by block. */
void capsyn_successors(const int64_t count, const double *restrict states, const lattice *g,
                       int32_t *restrict at, float *restrict weights, float *restrict costs)
{
    _Alignas(64) lanes_of_states first;
    for (int64_t start = 0; start < count; start += LANES) {
        load_block(count, states, start, first);
        lead(g, first, at, weights, costs);
        at += g->symbols * LANES;
        weights += g->symbols * AXES * LANES;
        costs += g->symbols * LANES;
    }
}

/* States and costs (count) after a sample from states (count, AXES) under controls (count, INPUTS). */
void capsyn_advance(const int64_t count, const double *restrict states,
                    const double *restrict controls, const lattice *g, double *restrict ends,
                    double *restrict costs)
{
    _Alignas(64) lanes_of_states x;
    _Alignas(64) double u[INPUTS][LANES];
    _Alignas(64) lanes total;
    for (int64_t start = 0; start < count; start += LANES) {
        const int used = load_block(count, states, start, x);
        for (int lane = 0; lane < LANES; ++lane)
            for (int i = 0; i < INPUTS; ++i)
                u[i][lane] = controls[(start + (lane < used ? lane : used - 1)) * INPUTS + i];
        advance(g, x, u, total);
        for (int lane = 0; lane < used; ++lane) {
            for (int i = 0; i < AXES; ++i)
                ends[(start + lane) * AXES + i] = x[i][lane];
            costs[start + lane] = total[lane];
        }
    }
}

typedef struct {
    const int32_t *at;
    const float *weights, *costs;
    const int32_t *corners; /* (CORNERS): entries of the corners of an interval, first axis first */
    const uint8_t *inner;   /* (AXES, nodes): whether an interval has another on either side */
    int64_t nodes;
    int64_t symbols, size;  /* size: entries of a row of values */
    const int64_t *held;    /* (symbols): samples that each is held once entered, >= 1 */
    const double *prices;   /* (symbols, symbols) from each to each, or NULL: one row of values */
} table;

/* Half the curvature of values along each axis (entries, AXES) in intervals first .. last - 1, by
 * their lower corners: the smaller one of both ends, so that kinks stay what they are. */
void capsyn_curvature(const int64_t first, const int64_t last, const table *t,
                      const double *restrict values, float *restrict out)
{
    for (int i = 0; i < AXES; ++i) {
        const int64_t s = t->corners[CORNERS >> (i + 1)];
        const uint8_t *inner = t->inner + i * t->nodes;
        const int64_t low = first > s ? first : s;
        const int64_t high = last < t->nodes - 2 * s ? last : t->nodes - 2 * s;
#pragma omp simd
        for (int64_t j = low; j < high; ++j) {
            const double here = values[j], next = values[j + s];
            const double a = next - 2 * here + values[j - s];
            const double b = values[j + 2 * s] - 2 * next + here;
            const double least = fabs(a) < fabs(b) ? a : b;
            const int good = inner[j] && a * b > 0 && fabs(least) < 1e-6 * HUGE_COST;
            out[j * AXES + i] = good ? (float)(0.5 * least) : 0.0f;
        }
    }
}

/* Cost of a symbol over a sample and of going on as a row of values says: between nodes it is
 * linear but for the curvature along each axis. */
static inline void follow(const table *t, const int64_t place, const double *restrict values,
                          const float *restrict bend, double *restrict out)
{
    const int32_t *restrict at = t->at + place * LANES;
    const float *restrict cost = t->costs + place * LANES;
    const float(*restrict w)[LANES] = (const float(*)[LANES])(t->weights + place * AXES * LANES);
    const int32_t *restrict corners = t->corners;
    EACH_LANE {
        double c[CORNERS];
#pragma GCC unroll 16
        for (int k = 0; k < CORNERS; ++k)
            c[k] = values[at[lane] + corners[k]];
#pragma GCC unroll 4
        for (int i = AXES - 1; i >= 0; --i) {
#pragma GCC unroll 8
            for (int k = 0; k < 1 << i; ++k)
                c[k] = c[2 * k] + (double)w[i][lane] * (c[2 * k + 1] - c[2 * k]);
        }
        float off = 0.0f;
#pragma GCC unroll 4
        for (int i = 0; i < AXES; ++i)
            off += w[i][lane] * (1.0f - w[i][lane]) * bend[at[lane] * AXES + i];
        const double sum = (double)cost[lane] + (c[0] - (double)off);
        out[lane] = sum < HUGE_COST ? sum : HUGE_COST;
    }
}

/* Costs (blocks, symbols, LANES) of a symbol, and then of row `rows` (symbols) of values. */
void capsyn_follow(const int64_t blocks, const table *t, const double *restrict values,
                   const float *restrict bends, const int64_t *restrict rows, double *restrict out)
{
    for (int64_t k = 0; k < blocks * t->symbols; ++k) {
        const int64_t row = rows[k % t->symbols] * t->size;
        follow(t, k, values + row, bends + row * AXES, out + k * LANES);
    }
}

/* New values of blocks first .. last - 1 by old ones; the least and largest change.
 *
 * Without prices there is one row. With them each symbol s has held[s] rows: that where it may
 * be left, and those where it is held for 1, 2 .. more samples. */
void capsyn_sweep(const int64_t first, const int64_t last, const table *t,
                  const double *restrict values, const float *restrict bends,
                  double *restrict out, double *restrict change)
{
    const int64_t symbols = t->symbols;
    _Alignas(64) double free[t->prices ? symbols : 1][LANES], entered[t->prices ? symbols : 1][LANES];
    _Alignas(64) lanes low, high, next;
    EACH_LANE {
        low[lane] = INFINITY;
        high[lane] = -INFINITY;
    }
    for (int64_t b = first; b < last; ++b) {
        const double *old = values + b * LANES;
        double *new = out + b * LANES;
        int64_t row = 0;
        for (int64_t s = 0; s < symbols; ++s) {
            if (!t->prices) {
                follow(t, b * symbols + s, values, bends, next);
                double *best = free[0];
                EACH_LANE {
                    best[lane] = s && best[lane] < next[lane] ? best[lane] : next[lane];
                }
                continue;
            }
            for (int64_t r = 0; r < t->held[s]; ++r, ++row) {
                double *to = r + 1 < t->held[s] ? new + (row + 1) * t->size : entered[s];
                follow(t, b * symbols + s, values + row * t->size,
                       bends + row * t->size * AXES, next);
                EACH_LANE {
                    to[lane] = next[lane];
                }
                if (r == 0)
                    EACH_LANE {
                        free[s][lane] = next[lane];
                    }
            }
        }
        row = 0;
        for (int64_t j = 0; j < (t->prices ? symbols : 1); ++j) {
            double *best = free[j], *to = new + row * t->size;
            const double *was = old + row * t->size;
            for (int64_t s = 0; t->prices && s < symbols; ++s) {
                const double price = t->prices[j * symbols + s];
                if (s != j && price < (double)INFINITY)
                    EACH_LANE {
                        const double other = entered[s][lane] + price;
                        best[lane] = other < best[lane] ? other : best[lane];
                    }
            }
            EACH_LANE {
                const double step = best[lane] - was[lane];
                low[lane] = step < low[lane] ? step : low[lane];
                high[lane] = step > high[lane] ? step : high[lane];
                to[lane] = best[lane];
            }
            row += t->prices ? t->held[j] : 1;
        }
    }
    for (int lane = 0; lane < LANES; ++lane) {
        change[0] = low[lane] < change[0] ? low[lane] : change[0];
        change[1] = high[lane] > change[1] ? high[lane] : change[1];
    }
}

typedef struct {
    int64_t samples;
    const double *lower, *upper;     /* (AXES): of the grid, infinite on periodic axes */
    const double *switches;          /* (symbols + 1, symbols), from the default last */
    const int64_t *tops, *entries;   /* (symbols): rows of values, see `Task` */
    int64_t remembers;
    double tie;
} journey;

/* The best symbol of a lane by what going on costs: of ties that in force, else the lowest. */
static int64_t chosen(const lattice *g, const journey *j, const double *stays,
                      const double *entered, const int64_t now, const int lane)
{
    const double *prices = j->switches + (now < 0 ? g->symbols : now) * g->symbols;
    double least = INFINITY, own = INFINITY;
    int64_t best = 0;
    for (int64_t s = 0; s < g->symbols; ++s) {
        const double *from = s == now ? stays : entered;
        const double sum = from[s * LANES + lane];
        const double cost = sum < HUGE_COST ? sum + (s == now ? 0 : prices[s]) : INFINITY;
        if (cost < least) {
            least = cost;
            best = s;
        }
        if (s == now)
            own = cost;
    }
    return j->remembers && now >= 0 && own <= least + j->tie * fabs(least) ? now : best;
}

/* Closed loops of the best symbols from states (count, AXES): costs and switches (count), and how
 * far they went beyond the lower and upper faces (2, count, AXES). Returns 0 without memory. */
int capsyn_loops(const int64_t count, const double *restrict states, const lattice *g,
                 const table *told, const journey *j, const double *restrict values,
                 const float *restrict bends, double *restrict costs, int64_t *restrict switches, double *restrict out)
{
    const int64_t symbols = g->symbols;
    _Alignas(64) lanes_of_states x;
    _Alignas(64) double u[INPUTS][LANES];
    _Alignas(64) lanes total;
    int over[LANES];
    const size_t each = (size_t)symbols * LANES;
    int32_t *at = malloc(each * sizeof *at);
    float *weights = malloc(each * (AXES + 1) * sizeof *weights);
    double *stays = malloc(2 * each * sizeof *stays);
    if (!at || !weights || !stays) {
        free(at), free(weights), free(stays);
        return 0;
    }
    float *own = weights + AXES * each;
    double *entered = stays + each;
    table t = *told;
    t.at = at, t.weights = weights, t.costs = own;
    for (int64_t start = 0; start < count; start += LANES) {
        const int used = load_block(count, states, start, x);
        int64_t now[LANES], rest[LANES];
        int live[LANES];
        for (int lane = 0; lane < LANES; ++lane) {
            now[lane] = -1;
            rest[lane] = 0;
            live[lane] = lane < used;
        }
        for (int64_t k = 0; k < j->samples; ++k) {
            int running = 0;
            arrived(x, over);
            for (int lane = 0; lane < used; ++lane) {
                for (int i = 0; i < AXES; ++i)
                    over[lane] |= !isfinite(x[i][lane]);
                live[lane] &= !over[lane];
                running |= live[lane];
            }
            if (!running)
                break;
            lead(g, x, at, weights, own);
            for (int64_t s = 0; s < symbols; ++s) {
                const int64_t top = j->tops[s] * t.size, entry = j->entries[s] * t.size;
                follow(&t, s, values + top, bends + top * AXES, stays + s * LANES);
                follow(&t, s, values + entry, bends + entry * AXES, entered + s * LANES);
            }
            for (int lane = 0; lane < LANES; ++lane) {
                if (live[lane]) {
                    const int64_t was = now[lane];
                    int64_t s = was;
                    if (rest[lane] <= 0)
                        s = chosen(g, j, stays, entered, was, lane);
                    if (s != was) {
                        costs[start + lane] += j->switches[(was < 0 ? symbols : was) * symbols + s];
                        switches[start + lane] += was >= 0;
                        rest[lane] = told->held[s];
                    }
                    --rest[lane];
                    now[lane] = s;
                }
                for (int i = 0; i < INPUTS; ++i)
                    u[i][lane] = g->controls[(now[lane] < 0 ? 0 : now[lane]) * INPUTS + i];
            }
            advance(g, x, u, total);
            for (int lane = 0; lane < used; ++lane) {
                if (!live[lane])
                    continue;
                int finite = 1;
                for (int i = 0; i < AXES; ++i)
                    finite &= isfinite(x[i][lane]) != 0;
                for (int i = 0; i < AXES; ++i)
                    for (int side = 0; side < 2; ++side) {
                        double far = side ? x[i][lane] - j->upper[i] : j->lower[i] - x[i][lane];
                        double *most = out + (side * count + start + lane) * AXES + i;
                        far = finite || isinf(j->lower[i]) ? far : (double)INFINITY;
                        *most = far > *most ? far : *most;
                    }
                costs[start + lane] +=
                    total[lane] + g->efforts[now[lane]] * (g->step * (double)g->steps);
            }
        }
    }
    free(at), free(weights), free(stays);
    return 1;
}
