/* Costs of finite-control-set model predictive control for blocks of LANES states.
 *
 * Needs STATES, INPUTS, SYMBOLS, DEPTH and the programs step and terminal_cost before it. The tree
 * of all sequences of DEPTH symbols is walked depth first, so that what sequences share is
 * integrated once. The last block is filled up with its last state, so that every state runs
 * through the very same instructions whatever its place in the batch.
 */
typedef double lanes_of_states[STATES][LANES];

typedef struct {
    const double *controls, *efforts; /* (SYMBOLS, INPUTS), and cost of each [cost / time unit] */
    const double *dt;                 /* (DEPTH): integration step of each move [time unit] */
    const int64_t *steps;             /* (DEPTH): integration steps of each move */
    const double *prices;             /* (SYMBOLS, SYMBOLS) of going from each to each [cost] */
} prediction;

void capsyn_finite_control_set(const int64_t count, const double *restrict states,
                               const prediction *plan, double *restrict costs)
{
    _Alignas(64) lanes_of_states path[DEPTH + 1], next;
    _Alignas(64) double total[DEPTH + 1][LANES], best[SYMBOLS][LANES];
    _Alignas(64) double part[1][LANES];
    int symbol[DEPTH];

    for (int64_t start = 0; start < count; start += LANES) {
        const int used = count - start < LANES ? (int)(count - start) : LANES;
        for (int lane = 0; lane < LANES; ++lane) {
            const double *state = states + (start + (lane < used ? lane : used - 1)) * STATES;
            for (int i = 0; i < STATES; ++i)
                path[0][i][lane] = state[i];
            total[0][lane] = ZERO;
            for (int s = 0; s < SYMBOLS; ++s)
                best[s][lane] = (double)INFINITY;
        }
        int depth = 0;
        symbol[0] = 0;
        while (depth >= 0) {
            if (symbol[depth] == SYMBOLS) {
                if (--depth >= 0)
                    ++symbol[depth];
                continue;
            }
            const int s = symbol[depth];
            const double price = depth ? plan->prices[symbol[depth - 1] * SYMBOLS + s] : ZERO;
            if (price == (double)INFINITY) { /* forbidden */
                ++symbol[depth];
                continue;
            }
            const double *u = plan->controls + s * INPUTS, *dt = plan->dt + depth;
            const double effort = plan->efforts[s] * (*dt * (double)plan->steps[depth]);
            lanes_of_states *to = path + depth + 1;
            step(path[depth], u, dt, *to, part);
            EACH_LANE {
                total[depth + 1][lane] = total[depth][lane] + effort + part[0][lane];
            }
            for (int64_t k = 1; k < plan->steps[depth]; ++k) {
                for (int i = 0; i < STATES; ++i)
                    EACH_LANE {
                        next[i][lane] = (*to)[i][lane];
                    }
                step(next, u, dt, *to, part);
                EACH_LANE {
                    total[depth + 1][lane] += part[0][lane];
                }
            }
            if (price > ZERO)
                EACH_LANE {
                    total[depth + 1][lane] += price;
                }
            if (depth + 1 < DEPTH) {
                symbol[++depth] = 0;
                continue;
            }
            terminal_cost(*to, part);
            double *least = best[symbol[0]];
            const double *sum = total[DEPTH];
            EACH_LANE {
                const double cost = sum[lane] + part[0][lane];
                least[lane] = cost < least[lane] ? cost : least[lane];
            }
            ++symbol[depth];
        }
        for (int lane = 0; lane < used; ++lane)
            for (int s = 0; s < SYMBOLS; ++s)
                costs[(start + lane) * SYMBOLS + s] = best[s][lane];
    }
}
