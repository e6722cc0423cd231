/* Labels of states from the arrays of a cell tree; see Box and CellTree for the rules.
 *
 * Needs STATES before it, and -ffp-contract=off: the faces must be rounded as everywhere else.
 * A label is a leaf number, OUTSIDE or NOT_FINITE.
 */
#include <float.h>
#include <math.h>
#include <stdint.h>

#define OUTSIDE (-2)
#define NOT_FINITE (-3)

static double face(double lower, double upper, int64_t count, int64_t k)
{
    return k >= count ? upper : lower + (upper - lower) * ((double)k / (double)count);
}

/* The entry of the leaf that holds the finest cell k, with digits by division. */
static int32_t leaf_of(const uint32_t *restrict k, const int64_t *restrict partitions,
                       const int64_t *restrict refinement, const uint32_t *restrict root_size,
                       const int32_t *restrict entries)
{
    uint32_t rest[STATES], size[STATES];
    int64_t entry = 0;
    for (int i = 0; i < STATES; ++i) {
        size[i] = root_size[i];
        entry = entry * partitions[i] + k[i] / size[i];
        rest[i] = k[i] % size[i];
    }
    while (entries[entry] >= 0) {
        int64_t child = 0;
        for (int i = 0; i < STATES; ++i) {
            size[i] /= (uint32_t)refinement[i];
            child = child * refinement[i] + rest[i] / size[i];
            rest[i] %= size[i];
        }
        entry = entries[entry] + child;
    }
    return entries[entry];
}

/* The same where every axis is refined by 2: the digits are bits. */
static int32_t leaf_of_bits(const uint32_t *restrict k, const int64_t *restrict partitions,
                            int level, const int32_t *restrict entries)
{
    int64_t entry = 0;
    for (int i = 0; i < STATES; ++i)
        entry = entry * partitions[i] + (k[i] >> level);
    while (entries[entry] >= 0) {
        uint32_t child = 0;
        --level;
        for (int i = 0; i < STATES; ++i)
            child = child * 2 + (k[i] >> level & 1);
        entry = entries[entry] + (int64_t)child;
    }
    return entries[entry];
}

void capsyn_lookup(const int64_t states_count, const double *restrict states,
                   const double *restrict lower, const double *restrict upper,
                   const uint8_t *restrict periodic, const int64_t *restrict counts,
                   const int64_t *restrict partitions, const int64_t *restrict refinement,
                   const int nearest, const int32_t *restrict entries, int32_t *restrict labels)
{
    double scale[STATES], doubt[STATES];
    uint32_t root_size[STATES];
    int binary = 1, level = 0;
    for (int i = 0; i < STATES; ++i) {
        const double width = upper[i] - lower[i], largest = fmax(fabs(lower[i]), fabs(upper[i]));
        scale[i] = (double)counts[i] / width;
        /* Only this close to a face, in steps, can rounding put a state into the wrong step. */
        doubt[i] = 16 * DBL_EPSILON * ((double)counts[i] + largest * scale[i]);
        root_size[i] = (uint32_t)(counts[i] / partitions[i]);
        binary &= refinement[i] == 2;
    }
    while ((uint32_t)1 << level < root_size[0])
        ++level;

    for (int64_t b = 0; b < states_count; ++b) {
        uint32_t steps[STATES];
        int32_t label = 0;
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
            const double place = (x - low) * scale[i];
            int64_t k = (int64_t)place;
            const double part = place - (double)k;
            if (k > counts[i] - 1)
                k = counts[i] - 1;
            if (part < doubt[i] || part > 1 - doubt[i]) {
                if (x < face(low, high, counts[i], k))
                    --k;
                else if (k + 1 < counts[i] && x >= face(low, high, counts[i], k + 1))
                    ++k;
            }
            steps[i] = (uint32_t)k;
        }
        if (label == NOT_FINITE || (label == OUTSIDE && !nearest))
            labels[b] = label;
        else if (binary)
            labels[b] = -1 - leaf_of_bits(steps, partitions, level, entries);
        else
            labels[b] = -1 - leaf_of(steps, partitions, refinement, root_size, entries);
    }
}
