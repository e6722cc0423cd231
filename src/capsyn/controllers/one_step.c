/* What one sample under each symbol changes of the cost of a discrete-time prediction, exactly.
 *
 * Needs STATES, INPUTS, SYMBOLS and the programs move (x, u, dt), step (x, dt), which is the same
 * under the default control, and terminal_cost before it; dt does not matter to a map. The last
 * block is filled up with its last state, so that every state runs through the very same
 * instructions whatever its place in the batch.
 */
void capsyn_one_step(const int64_t count, const double *restrict states, const int steps,
                     const double *restrict controls, const double tolerance,
                     const double rounding, double *restrict cost, double *restrict changes,
                     double *restrict scales)
{
    _Alignas(64) real path[2][STATES][LANES], first[STATES][LANES];
    _Alignas(64) real total[LANES], part[1][LANES], base[LANES];
    const real dt[1] = {ZERO};

    for (int64_t start = 0; start < count; start += LANES) {
        const int used = count - start < LANES ? (int)(count - start) : LANES;
        for (int lane = 0; lane < LANES; ++lane) {
            const double *state = states + (start + (lane < used ? lane : used - 1)) * STATES;
            for (int i = 0; i < STATES; ++i)
                first[i][lane] = (real)state[i];
        }
        for (int s = -1; s < SYMBOLS; ++s) { /* the default first */
            if (s < 0) {
                step(first, dt, path[0], part);
            } else {
                real u[INPUTS];
                for (int i = 0; i < INPUTS; ++i)
                    u[i] = (real)controls[s * INPUTS + i];
                move(first, u, dt, path[0], part);
            }
            EACH_LANE {
                total[lane] = part[0][lane];
            }
            int at = 0;
            for (int k = 1; k < steps; ++k, at = !at) {
                step(path[at], dt, path[!at], part);
                EACH_LANE {
                    total[lane] += part[0][lane];
                }
            }
            terminal_cost(path[at], part);
            EACH_LANE {
                total[lane] += part[0][lane];
                base[lane] = s < 0 ? total[lane] : base[lane];
            }
            for (int lane = 0; lane < used; ++lane) {
                const double own = (double)total[lane], idle = (double)base[lane];
                if (s < 0) {
                    cost[start + lane] = idle;
                } else {
                    changes[s * count + start + lane] = own - idle;
                    scales[s * count + start + lane] = tolerance * fabs(own) + rounding * fabs(idle);
                }
            }
        }
    }
}
