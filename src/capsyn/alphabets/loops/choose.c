/* What sSAC applies in LANES states, without cells, each among the symbols of its own alphabet.
 *
 * Needs lookup.c, STATES, INPUTS, FIRST and the programs step, adjoint, terminal_cost and insertion
 * (of one symbol) before it. The rules are those of `BatchController` in controllers/ssac.py; the
 * default control is the label after all symbols.
 */
typedef struct {
    const int64_t *first;   /* (alphabets + 1): where the symbols of each alphabet begin */
    const int64_t *symbols; /* of all alphabets, of each those of least effort first */
    const double *efforts;  /* (symbols + 1), the default's last [cost / time unit] */
    const double *prices, *shares; /* (symbols + 1, symbols + 1), from each to each, or NULL; */
    const double *spreads;         /* (alphabets): prices are prices + spread * shares */
    double horizon, rounding, tie, gamma, alpha_d; /* alpha_d: NaN where gamma holds */
    int64_t steps, steepest, to_default, longest;
    int32_t *uses; /* (trials, longest): samples that each symbol of its alphabet was in force */
} choice;

typedef double lanes_of_numbers[LANES];

/* What the decisions of a block need beside its trials. */
typedef struct {
    double (*path)[STATES][LANES];
    lanes_of_numbers *gradients, *scales;
    double (*measured)[LANES];
    void *memory;
} room;

static int make_room(room *space, const choice *c)
{
    const size_t states = sizeof(double[STATES][LANES]), numbers = sizeof(lanes_of_numbers);
    const size_t path = states * ((size_t)c->steps + 4);
    space->memory = malloc(path + 2 * numbers * (size_t)c->longest + 63);
    if (!space->memory)
        return 0;
    char *at = (char *)space->memory + (63 & -(uintptr_t)space->memory);
    space->path = (void *)at;
    space->measured = space->path[c->steps + 3];
    space->gradients = (void *)(at + path);
    space->scales = space->gradients + c->longest;
    return 1;
}

/* The states of the domain that are nearest to those measured, angles in their period. */
static void place(const tree *box, double x[STATES][LANES])
{
    for (int i = 0; i < STATES; ++i) {
        const double low = box->lower[i], high = box->upper[i];
        for (int lane = 0; lane < LANES; ++lane) {
            double value = x[i][lane];
            if (value >= low && value < high)
                continue;
            if (box->periodic[i]) {
                double offset = fmod(value - low, high - low);
                offset += offset < 0 ? high - low : 0.0;
                value = low + offset >= high ? low : low + offset;
            } else if (value < low || value > high) {
                value = value < low ? low : high;
            }
            x[i][lane] = value;
        }
    }
}

/* Bounds of what a symbol scores under the perturbations of a tie. */
static void bounds(const choice *c, const double gradient, const double scale, const double wanted,
                   const double effort, double *low, double *high)
{
    const double margin = c->tie * scale;
    if (c->steepest) {
        *low = gradient - margin + effort;
        *high = gradient + margin + effort;
        return;
    }
    const double distance = fabs(gradient - wanted);
    const double near = distance - margin > 0 ? distance - margin : 0.0;
    *low = near * near + effort;
    *high = (distance + margin) * (distance + margin) + effort;
}

/* The same where switches have prices; `size` is what scores of eq. (8) are divided by. */
static void priced_bounds(const choice *c, const double gradient, const double scale,
                          const double wanted, const double effort, const double cheapest,
                          const double size, double *low, double *high)
{
    if (c->steepest) {
        bounds(c, gradient, scale, wanted, effort, low, high);
        return;
    }
    const double margin = c->tie * scale, extra = effort - cheapest;
    const double squares = gradient * (gradient - 2 * wanted) + margin * margin + extra;
    const double distance = fabs(gradient - wanted), reach = 2 * margin * distance;
    *low = distance > margin ? squares - reach : extra - wanted * wanted;
    *high = squares + reach;
    if (size > 0) {
        *low /= size;
        *high /= size;
    } else {
        *low = *high = extra;
    }
    if (!isfinite(scale) || !isfinite(gradient) || !isfinite(wanted))
        *high = INFINITY;
}

/* The label of the first of an alphabet that could be best in a lane; `none`, the default, where no
 * result is finite. */
static int64_t best(const room *space, const choice *c, const int lane, const int64_t alphabet,
                    const double cost, const int64_t none)
{
    const int64_t *own = c->symbols + c->first[alphabet];
    const int64_t count = c->first[alphabet + 1] - c->first[alphabet];
    const double wanted = isnan(c->alpha_d) ? c->gamma * cost : c->alpha_d;
    double least = INFINITY, low, high;
    for (int64_t k = 0; k < count; ++k) {
        const double gradient = space->gradients[k][lane], scale = space->scales[k][lane];
        bounds(c, gradient, scale, wanted, c->efforts[own[k]], &low, &high);
        if (!isfinite(high))
            return none;
        least = high < least ? high : least;
    }
    int64_t found = -1, idle = 0;
    for (int64_t k = 0; k < count; ++k) {
        const double gradient = space->gradients[k][lane];
        const double margin = c->tie * space->scales[k][lane];
        bounds(c, gradient, space->scales[k][lane], wanted, c->efforts[own[k]], &low, &high);
        if (low > least)
            continue;
        idle |= c->to_default && gradient + margin >= 0;
        if (found < 0 && (!c->to_default || gradient - margin < 0))
            found = own[k];
    }
    return found < 0 || (idle && c->efforts[none] < c->efforts[found]) ? none : found;
}

/* The same where switches have prices: the label in force first, of those that could be best. */
static int64_t best_priced(const room *space, const choice *c, const int lane,
                           const int64_t alphabet, const double cost, const int64_t none,
                           const int64_t now)
{
    const int64_t *own = c->symbols + c->first[alphabet];
    const int64_t count = c->first[alphabet + 1] - c->first[alphabet];
    const double wanted = isnan(c->alpha_d) ? c->gamma * cost : c->alpha_d;
    const double cheapest = c->efforts[own[0]];
    double squares = 0, least = INFINITY, low, high;
    for (int64_t k = 0; k < count; ++k)
        squares += space->gradients[k][lane] * space->gradients[k][lane];
    const double size = 2 * sqrt(wanted * wanted + squares / (double)count);
    int64_t found = -1;
    for (int pass = 0; pass < 2; ++pass)
        for (int64_t k = 0; k < count; ++k) {
            const int64_t at = now * (none + 1) + own[k];
            const double price = c->prices[at] + (c->shares[at] ? c->spreads[alphabet] * c->shares[at] : 0.0);
            priced_bounds(c, space->gradients[k][lane], space->scales[k][lane], wanted,
                          c->efforts[own[k]], cheapest, size, &low, &high);
            if (!isfinite(high))
                return none;
            if (!pass)
                least = high + price < least ? high + price : least;
            else if (isfinite(least) && low + price <= least && (found < 0 || own[k] == now))
                found = own[k];
        }
    return found < 0 ? none : found;
}

/* The labels that sSAC takes in the measured states, of `symbols` symbols and the default. */
static void choose(room *space, const choice *c, const tree *box, const double *controls,
                   const int64_t symbols, const int64_t *alphabets, const int64_t *now,
                   int64_t *chosen)
{
    const double dt[1] = {c->horizon / (double)c->steps}, noise[1] = {c->rounding};
    double (*path)[STATES][LANES] = space->path, (*rho)[STATES][LANES] = path + c->steps + 1;
    _Alignas(64) double total[1][LANES], part[1][LANES], control[INPUTS][LANES];
    int64_t most = 0;

    place(box, space->measured);
    for (int i = 0; i < STATES; ++i)
        EACH_LANE {
            path[0][i][lane] = space->measured[i][lane];
        }
    EACH_LANE {
        total[0][lane] = 0;
    }
    for (int64_t k = 0; k < c->steps; ++k) {
        step(path[k], dt, path[k + 1], part);
        EACH_LANE {
            total[0][lane] += part[0][lane];
        }
    }
    terminal_cost(path[c->steps], part, rho[0]);
    EACH_LANE {
        total[0][lane] += part[0][lane];
    }
    int from = 0;
    for (int64_t k = c->steps - 1; k >= FIRST; --k, from = !from)
        adjoint(path[k], dt, rho[from], rho[!from]);
    for (int lane = 0; lane < LANES; ++lane) {
        const int64_t count = c->first[alphabets[lane] + 1] - c->first[alphabets[lane]];
        most = count > most ? count : most;
    }
    for (int64_t k = 0; k < most; ++k) {
        for (int lane = 0; lane < LANES; ++lane) {
            const int64_t first = c->first[alphabets[lane]], count = c->first[alphabets[lane] + 1] - first;
            const double *u = controls + c->symbols[first + (k < count ? k : 0)] * INPUTS;
            for (int i = 0; i < INPUTS; ++i)
                control[i][lane] = u[i];
        }
        insertion(path[0], rho[from], total, noise, control, space->gradients + k, space->scales + k);
    }
    for (int lane = 0; lane < LANES; ++lane)
        chosen[lane] = c->prices ? best_priced(space, c, lane, alphabets[lane], total[0][lane], symbols, now[lane])
                                 : best(space, c, lane, alphabets[lane], total[0][lane], symbols);
}

/* Count a sample of a symbol in force, if it is one of the alphabet. */
static void count_use(const choice *c, const int64_t trial, const int64_t alphabet,
                      const int64_t symbol)
{
    const int64_t *own = c->symbols + c->first[alphabet];
    const int64_t count = c->first[alphabet + 1] - c->first[alphabet];
    for (int64_t k = 0; k < count; ++k)
        if (own[k] == symbol) {
            ++c->uses[trial * c->longest + k];
            return;
        }
}
