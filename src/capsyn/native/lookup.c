/* Labels of states from the arrays of a cell tree; see Box and CellTree for the rules.
 *
 * Needs STATES before it, and -ffp-contract=off: the faces must be rounded as everywhere else.
 * A label is a leaf number, OUTSIDE or NOT_FINITE.
 */
#include <math.h>
#include <stdint.h>

#define OUTSIDE (-2)
#define NOT_FINITE (-3)

static double face(double lower, double upper, int64_t count, int64_t k)
{
    return k >= count ? upper : lower + (upper - lower) * ((double)k / (double)count);
}

void capsyn_lookup(const int64_t states_count, const double *restrict states,
                   const double *restrict lower, const double *restrict upper,
                   const uint8_t *restrict periodic, const int64_t *restrict counts,
                   const int64_t *restrict partitions, const int64_t *restrict refinement,
                   const int nearest, const int32_t *restrict entries, int32_t *restrict labels)
{
    for (int64_t b = 0; b < states_count; ++b) {
        uint32_t rest[STATES], size[STATES];
        int32_t label = 0;
        int64_t entry = 0;
        for (int i = 0; i < STATES; ++i) {
            double x = states[b * STATES + i];
            const double low = lower[i], high = upper[i];
            if (!isfinite(x)) {
                label = NOT_FINITE;
                break;
            }
            if (!(x >= low && x < high)) {
                if (periodic[i]) {
                    double offset = fmod(x - low, high - low);
                    if (offset < 0)
                        offset += high - low;
                    x = low + offset;
                    if (x >= high)
                        x = low;
                } else {
                    if (x != high)
                        label = OUTSIDE;
                    x = x < low ? low : high;
                }
            }
            int64_t k = (int64_t)((x - low) * ((double)counts[i] / (high - low)));
            if (k > counts[i] - 1)
                k = counts[i] - 1;
            if (x < face(low, high, counts[i], k))
                --k;
            else if (k + 1 < counts[i] && x >= face(low, high, counts[i], k + 1))
                ++k;
            size[i] = (uint32_t)(counts[i] / partitions[i]);
            entry = entry * partitions[i] + (uint32_t)k / size[i];
            rest[i] = (uint32_t)k % size[i];
        }
        if (label == NOT_FINITE || (label == OUTSIDE && !nearest)) {
            labels[b] = label;
            continue;
        }
        while (entries[entry] >= 0) {
            int64_t child = 0;
            for (int i = 0; i < STATES; ++i) {
                size[i] /= (uint32_t)refinement[i];
                const uint32_t digit = rest[i] / size[i];
                rest[i] -= digit * size[i];
                child = child * refinement[i] + digit;
            }
            entry = entries[entry] + child;
        }
        labels[b] = -1 - entries[entry];
    }
}
