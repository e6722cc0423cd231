/* Steps 1 and 2 of sSAC (Section III-A of the paper) at t0, for blocks of LANES states.
 *
 * Needs STATES, SYMBOLS, FIRST and the programs step, adjoint, terminal_cost and insertion before
 * it; the insertion gets the adjoint after FIRST steps.
 * The last block is filled up with its last state, so that every state runs through the very same
 * instructions whatever its place in the batch.
 */
int capsyn_ssac(const int64_t count, const double *restrict states, const double horizon,
                const int steps, const double rounding, double *restrict cost,
                double *restrict gradients, double *restrict scales)
{
    typedef real lanes_of_states[STATES][LANES];
    const real dt[1] = {(real)(horizon / steps)}, noise[1] = {(real)rounding};
    const size_t size = sizeof(lanes_of_states) * ((size_t)steps + 3);
    char *memory = malloc(size + 63);
    if (memory == NULL)
        return -1;
    lanes_of_states *path = (void *)(memory + (63 & -(uintptr_t)memory)); /* at a multiple of 64 */
    lanes_of_states *rho = path + steps + 1; /* two of them, used in turn */
    _Alignas(64) real total[1][LANES], part[1][LANES];
    _Alignas(64) real gradient[SYMBOLS][LANES], scale[SYMBOLS][LANES];

    for (int64_t start = 0; start < count; start += LANES) {
        const int used = count - start < LANES ? (int)(count - start) : LANES;
        for (int lane = 0; lane < LANES; ++lane) {
            const double *state = states + (start + (lane < used ? lane : used - 1)) * STATES;
            for (int i = 0; i < STATES; ++i)
                path[0][i][lane] = (real)state[i];
            total[0][lane] = ZERO;
        }
        for (int k = 0; k < steps; ++k) {
            step(path[k], dt, path[k + 1], part);
            EACH_LANE {
                total[0][lane] += part[0][lane];
            }
        }
        terminal_cost(path[steps], part, rho[0]);
        EACH_LANE {
            total[0][lane] += part[0][lane];
        }
        for (int k = steps - 1, from = 0; k >= FIRST; --k, from = !from)
            adjoint(path[k], dt, rho[from], rho[!from]);
        insertion(path[0], rho[(steps - FIRST) % 2], total, noise, gradient, scale);
        for (int lane = 0; lane < used; ++lane) {
            cost[start + lane] = (double)total[0][lane];
            for (int i = 0; i < SYMBOLS; ++i) {
                gradients[i * count + start + lane] = (double)gradient[i][lane];
                scales[i * count + start + lane] = (double)scale[i][lane];
            }
        }
    }
    free(memory);
    return 0;
}
