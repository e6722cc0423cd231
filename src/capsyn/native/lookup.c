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

typedef struct {
    const double *lower, *upper;
    const uint8_t *periodic;
    const int64_t *counts, *partitions, *refinement;
    const int32_t *entries;
} tree;

/* What a lookup needs of a tree beside its arrays. */
typedef struct {
    double scale[STATES], doubt[STATES];
    uint32_t root_size[STATES];
    int binary, level;
} measures;

static measures measure(const tree *cells)
{
    measures m = {.binary = 1, .level = 0};
    for (int i = 0; i < STATES; ++i) {
        const double low = cells->lower[i], high = cells->upper[i];
        const double count = (double)cells->counts[i];
        m.scale[i] = count / (high - low);
        /* Only this close to a face, in steps, can rounding put a state into the wrong step. */
        m.doubt[i] = 16 * DBL_EPSILON * (count + fmax(fabs(low), fabs(high)) * m.scale[i]);
        m.root_size[i] = (uint32_t)(cells->counts[i] / cells->partitions[i]);
        m.binary &= cells->refinement[i] == 2;
    }
    while ((uint32_t)1 << m.level < m.root_size[0])
        ++m.level;
    return m;
}

static double face(double lower, double upper, int64_t count, int64_t k)
{
    return k >= count ? upper : lower + (upper - lower) * ((double)k / (double)count);
}

/* The entry of the leaf that holds the finest cell k, with digits by division. */
static int32_t leaf_of(const uint32_t *restrict k, const tree *cells, const measures *m)
{
    uint32_t rest[STATES], size[STATES];
    int64_t entry = 0;
    for (int i = 0; i < STATES; ++i) {
        size[i] = m->root_size[i];
        entry = entry * cells->partitions[i] + k[i] / size[i];
        rest[i] = k[i] % size[i];
    }
    while (cells->entries[entry] >= 0) {
        int64_t child = 0;
        for (int i = 0; i < STATES; ++i) {
            size[i] /= (uint32_t)cells->refinement[i];
            child = child * cells->refinement[i] + rest[i] / size[i];
            rest[i] %= size[i];
        }
        entry = cells->entries[entry] + child;
    }
    return cells->entries[entry];
}

/* The same where every axis is refined by 2: the digits are bits. */
static int32_t leaf_of_bits(const uint32_t *restrict k, const tree *cells, int level)
{
    int64_t entry = 0;
    for (int i = 0; i < STATES; ++i)
        entry = entry * cells->partitions[i] + (k[i] >> level);
    while (cells->entries[entry] >= 0) {
        uint32_t child = 0;
        --level;
        for (int i = 0; i < STATES; ++i)
            child = child * 2 + (k[i] >> level & 1);
        entry = cells->entries[entry] + (int64_t)child;
    }
    return cells->entries[entry];
}

/* The label of the cell that holds a state or is nearest to it, or NOT_FINITE. */
static inline int32_t nearest_label(const tree *cells, const measures *m,
                                    const double *restrict state, int *restrict outside)
{
    uint32_t steps[STATES];
    *outside = 0;
    for (int i = 0; i < STATES; ++i) {
        double x = state[i];
        const double low = cells->lower[i], high = cells->upper[i];
        const int64_t count = cells->counts[i];
        if (!isfinite(x))
            return NOT_FINITE;
        if (!(x >= low && x < high)) {
            if (cells->periodic[i]) {
                double offset = fmod(x - low, high - low);
                if (offset < 0)
                    offset += high - low;
                x = low + offset;
                if (x >= high)
                    x = low;
            } else {
                *outside |= x != high;
                x = x < low ? low : high;
            }
        }
        const double place = (x - low) * m->scale[i];
        int64_t k = (int64_t)place;
        const double part = place - (double)k;
        if (k > count - 1)
            k = count - 1;
        if (part < m->doubt[i] || part > 1 - m->doubt[i]) {
            if (x < face(low, high, count, k))
                --k;
            else if (k + 1 < count && x >= face(low, high, count, k + 1))
                ++k;
        }
        steps[i] = (uint32_t)k;
    }
    return -1 - (m->binary ? leaf_of_bits(steps, cells, m->level) : leaf_of(steps, cells, m));
}

void capsyn_lookup(const int64_t count, const double *restrict states, const tree *cells,
                   const int nearest, int32_t *restrict labels)
{
    const tree local = *cells;
    const measures m = measure(&local);
    for (int64_t b = 0; b < count; ++b) {
        int outside;
        const int32_t label = nearest_label(&local, &m, states + b * STATES, &outside);
        labels[b] = label != NOT_FINITE && outside && !nearest ? OUTSIDE : label;
    }
}
