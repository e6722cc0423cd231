/* Labels of states from the arrays of a cell tree or a decision tree; see Box, CellTree and
 * SplitTree for the rules.
 *
 * Needs STATES before it, and -ffp-contract=off: the faces must be rounded as everywhere else.
 * A label is the number of a row (of an affine leaf the label that follows the one in force), OUTSIDE
 * or NOT_FINITE.
 */
#include <float.h>
#include <math.h>
#include <stdint.h>

#define OUTSIDE (-2)
#define NOT_FINITE (-3)
#define WALKS 64 /* states that go down a decision tree side by side, to overlap their loads */

/* A split goes on to child[value >= threshold]; a leaf's children are itself. */
typedef struct {
    int32_t split, threshold, child[2];
} node;

typedef struct {
    const double *lower, *upper;
    const uint8_t *periodic;
    const int64_t *counts;
    const int64_t *partitions, *refinement; /* of a cell tree, which has no nodes */
    const int32_t *entries;
    const uint16_t *splits; /* the axes that cells are split along, or none: all of them */
    const node *nodes; /* of a decision tree; threshold of a leaf: its label */
    const int32_t *planes, *starts;
    int64_t oblique, shift;
    int64_t affine; /* number of the first affine leaf of a cell tree; see AffineLeaves */
    const int32_t *row_starts, *row_symbols, *row_constants;
    const int16_t *row_slopes;
    const int32_t *row_prices; /* of affine leaves, or none */
    const int16_t *row_ratios; /* (labels, labels), from each label to each */
    int64_t labels;
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
        if (cells->nodes)
            continue;
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
        const uint32_t axes = cells->splits ? cells->splits[entry] : UINT32_MAX;
        int64_t child = 0;
        for (int i = 0; i < STATES; ++i) {
            if (!(axes >> i & 1))
                continue;
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

/* The same where cells are split along some axes only. */
static int32_t leaf_of_some_bits(const uint32_t *restrict k, const tree *cells, int level)
{
    int levels[STATES];
    int64_t entry = 0;
    for (int i = 0; i < STATES; ++i) {
        levels[i] = level;
        entry = entry * cells->partitions[i] + (k[i] >> level);
    }
    while (cells->entries[entry] >= 0) {
        const uint32_t axes = cells->splits[entry];
        uint32_t child = 0;
        for (int i = 0; i < STATES; ++i)
            if (axes >> i & 1)
                child = child * 2 + (k[i] >> --levels[i] & 1);
        entry = cells->entries[entry] + (int64_t)child;
    }
    return cells->entries[entry];
}

/* The node at which a walk begins: that which holds the whole block of the finest cell k. */
static inline int32_t start_of(const uint32_t *restrict k, const tree *t)
{
    int64_t block = 0;
    for (int i = 0; i < STATES; ++i)
        block = block * ((t->counts[i] - 1 >> t->shift) + 1) + (k[i] >> t->shift);
    return t->starts[block];
}

/* What a node compares, of the finest cell k. */
static inline int64_t split_value(const uint32_t *restrict k, const tree *t, int32_t split)
{
    if (split < STATES)
        return k[split];
    int64_t sum = 0;
    for (int i = 0; i < STATES; ++i)
        sum += t->planes[(split - STATES) * STATES + i] * (int64_t)k[i];
    return sum;
}

static int32_t label_of_node(const uint32_t *restrict k, const tree *t)
{
    int32_t at = start_of(k, t), last;
    do {
        const node *here = t->nodes + (last = at);
        at = here->child[split_value(k, t, here->split) >= here->threshold];
    } while (at != last);
    return t->nodes[at].threshold;
}

/* The symbol of an affine leaf at the finest cell k: that of the first of its largest rows; with
 * prices, of those that may follow the label `now`, which comes first of equals. */
static int32_t label_of_rows(const uint32_t *restrict k, const tree *t, int64_t leaf, int32_t now)
{
    int64_t most = INT64_MIN;
    int32_t best = now;
    for (int32_t row = t->row_starts[leaf]; row < t->row_starts[leaf + 1]; ++row) {
        int64_t value = t->row_constants[row];
        for (int i = 0; i < STATES; ++i)
            value += t->row_slopes[(int64_t)row * STATES + i] * (int64_t)k[i];
        const int32_t symbol = t->row_symbols[row];
        int stays = 0;
        if (t->row_prices) {
            const int64_t ratio = t->row_ratios[now * t->labels + symbol];
            if (ratio < 0)
                continue;
            value -= t->row_prices[leaf] * ratio;
            stays = value == most && symbol == now;
        }
        if (value > most || stays) {
            most = value;
            best = symbol;
        }
    }
    return best;
}

static inline int32_t label_of(const uint32_t *restrict k, const tree *cells, const measures *m,
                               const int32_t now)
{
    if (cells->nodes)
        return label_of_node(k, cells);
    const int32_t leaf = -1 - (!m->binary      ? leaf_of(k, cells, m)
                               : cells->splits ? leaf_of_some_bits(k, cells, m->level)
                                               : leaf_of_bits(k, cells, m->level));
    return leaf >= cells->affine ? label_of_rows(k, cells, leaf - cells->affine, now) : leaf;
}

/* The finest cell that holds a state or is nearest to it; whether there is one. */
static inline int quantise(const tree *cells, const measures *m, const double *restrict state,
                           uint32_t *restrict steps, int *restrict outside)
{
    *outside = 0;
    for (int i = 0; i < STATES; ++i) {
        double x = state[i];
        const double low = cells->lower[i], high = cells->upper[i];
        const int64_t count = cells->counts[i];
        if (!isfinite(x))
            return 0;
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
    return 1;
}

/* The label of the cell that holds a state or is nearest to it, or NOT_FINITE. */
static inline int32_t nearest_label(const tree *cells, const measures *m,
                                    const double *restrict state, const int32_t now,
                                    int *restrict outside)
{
    uint32_t steps[STATES];
    return quantise(cells, m, state, steps, outside) ? label_of(steps, cells, m, now) : NOT_FINITE;
}

/* Labels of WALKS states by a decision tree. */
static void walk(const double *restrict states, const tree *t, const measures *m, const int nearest,
                 int32_t *restrict labels)
{
    uint32_t steps[WALKS][STATES];
    int32_t at[WALKS];
    int known[WALKS], outside[WALKS], moving[WALKS], left = WALKS;
    for (int w = 0; w < WALKS; ++w) {
        known[w] = quantise(t, m, states + w * STATES, steps[w], outside + w);
        if (!known[w])
            for (int i = 0; i < STATES; ++i)
                steps[w][i] = 0;
        at[w] = start_of(steps[w], t);
        moving[w] = w;
    }
    while (left) {
        int kept = 0;
        for (int j = 0; j < left; ++j) {
            const int w = moving[j];
            const node *here = t->nodes + at[w];
            const int64_t value =
                t->oblique ? split_value(steps[w], t, here->split) : steps[w][here->split];
            const int32_t next = here->child[value >= here->threshold];
            moving[kept] = w;
            kept += next != at[w];
            at[w] = next;
        }
        left = kept;
    }
    for (int w = 0; w < WALKS; ++w)
        labels[w] = !known[w]                  ? NOT_FINITE
                    : outside[w] && !nearest ? OUTSIDE
                                             : t->nodes[at[w]].threshold;
}

/* `in_force` (count) are labels in force, or NULL: the default's. */
void capsyn_lookup(const int64_t count, const double *restrict states, const tree *cells,
                   const int nearest, const int32_t *in_force, int32_t *restrict labels)
{
    const tree local = *cells;
    const measures m = measure(&local);
    int64_t b = 0;
    if (local.nodes)
        for (; b + WALKS <= count; b += WALKS)
            walk(states + b * STATES, &local, &m, nearest, labels + b);
    for (; b < count; ++b) {
        int outside;
        const int32_t now = in_force ? in_force[b] : (int32_t)local.labels - 1;
        const int32_t label = nearest_label(&local, &m, states + b * STATES, now, &outside);
        labels[b] = label != NOT_FINITE && outside && !nearest ? OUTSIDE : label;
    }
}
