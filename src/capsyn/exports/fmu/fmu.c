/* What an FMU of a policy does; the constants and tables come before it. FMI 2.0, co-simulation. */
#include <float.h>
#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#if defined(FLT_EVAL_METHOD) && (FLT_EVAL_METHOD == 2 || FLT_EVAL_METHOD < 0)
#error "needs double arithmetic without excess precision, such as -msse2 -mfpmath=sse"
#endif
#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORT __attribute__((visibility("default")))
#else
#define EXPORT
#endif
#define PASTED(a, b) a##b
#define PASTE(a, b) PASTED(a, b)
#ifdef FMI2_FUNCTION_PREFIX
#define FMI(type, name) EXPORT type PASTE(FMI2_FUNCTION_PREFIX, name)
#else
#define FMI(type, name) EXPORT type name
#endif

typedef double Real;
typedef int Integer;
typedef int Boolean;
typedef char Char;
typedef char Byte;
typedef const Char *String;
typedef unsigned int Reference;
typedef void *Component;
typedef enum { OK, WARNING, DISCARD, ERROR, FATAL, PENDING } Status;
enum { INSIDE, OUTSIDE, NOT_FINITE };

typedef struct {
#ifdef REMEMBERS
    Real inputs[STATES], times[TIMES + 1], time, start, since; /* since: its symbol was entered */
    Real changes[CONTROLS]; /* when each input changed */
#else
    Real inputs[STATES], dwell, time, since;
#endif
    int symbol;  /* that is held, or -1 before the first */
    int status;
    int changed; /* whether the inputs are newer than the symbol */
} policy;

static int step(int i, double x) {
    const double low = LOWER[i], high = UPPER[i], width = high - low;
    const int count = COUNTS[i];
    volatile double product; /* volatile: a * b + c must not be contracted into one rounding */
    double place;
    int k;
    if (PERIODIC[i] && !(x >= low && x < high)) {
        double rest = fmod(x - low, width);
        if (rest < 0.0) rest = rest + width;
        rest = low + rest;
        x = rest >= high ? low : rest;
    }
    x = x < low ? low : x > high ? high : x;
    place = (x - low) * ((double)count / width);
    k = place >= (double)(count - 1) ? count - 1 : (int)place;
    product = width * ((double)k / (double)count);
    if (x < low + product) --k;
    product = width * ((double)(k + 1) / (double)count);
    if (k + 1 < count && x >= low + product) ++k;
    return k;
}

#ifdef CELLS
#ifdef REMEMBERS
/* Down to a leaf: the label that follows that in force. Of affine leaves it is that of the largest
 * row; with prices, which are taken off, of equals that in force. */
static int label_of(const int *z, int now) {
#else
/* Down to a leaf; up to DEFAULT it is a label, else that of its largest row, of equals the first. */
static int label_of(const int *z) {
#endif
    int i, row, label, most = 0, size[STATES];
    long at = 0, child;
    for (i = 0; i < STATES; ++i) {
        size[i] = ROOT_SIZES[i];
        at = at * PARTITIONS[i] + z[i] / size[i];
    }
    while (ENTRIES[at] >= 0) {
        for (child = 0, i = 0; i < STATES; ++i) {
            if (CELLS == 2 && !(SPLITS[at] >> i & 1)) continue;
            size[i] /= REFINEMENT[i];
            child = child * REFINEMENT[i] + z[i] / size[i] % REFINEMENT[i];
        }
        at = ENTRIES[at] + child;
    }
    at = -1 - ENTRIES[at];
#ifdef REMEMBERS
    if (at < ROWS) return TRANSITIONS[at][now];
    at -= ROWS;
#else
    if (at <= DEFAULT) return (int)at;
    at -= DEFAULT + 1;
#endif
    for (row = ROW_STARTS[at], label = -1; row < ROW_STARTS[at + 1]; ++row) {
        int value = ROW_CONSTANTS[row];
#ifdef PRICES
        const int ratio = ROW_RATIOS[now * LABELS + ROW_SYMBOLS[row]];
        if (ratio < 0) continue;
        value -= ROW_PRICES[at] * ratio;
#endif
        for (i = 0; i < STATES; ++i) value += ROW_SLOPES[(long)row * STATES + i] * z[i];
#ifdef PRICES
        if (label < 0 || value > most || (value == most && ROW_SYMBOLS[row] == now)) {
#else
        if (label < 0 || value > most) {
#endif
            most = value;
            label = ROW_SYMBOLS[row];
        }
    }
#ifdef PRICES
    return label < 0 ? now : label;
#else
    return label;
#endif
}
#else
#ifdef REMEMBERS
static int label_of(const int *z, int now) {
#else
static int label_of(const int *z) {
#endif
    int i, node = 0;
    while (SPLIT[node] >= 0) {
        int value = 0;
        if (SPLIT[node] < PLACES) value = z[SPLIT[node]];
        else for (i = 0; i < PLACES; ++i) value += PLANES[SPLIT[node] - PLACES][i] * z[i];
        node = value >= THRESHOLD[node] ? SECOND[node] : node + 1;
    }
#ifdef REMEMBERS
    return TRANSITIONS[THRESHOLD[node]][now];
#else
    return THRESHOLD[node];
#endif
}
#endif

#ifdef REMEMBERS
static int decide(const Real *inputs, int now, int *status) {
#else
static int decide(const Real *inputs, int *status) {
#endif
    int i, z[PLACES], label;
    double x[STATES];
    *status = INSIDE;
    for (i = 0; i < STATES; ++i) {
        volatile double product = inputs[i] * SCALE[i];
        x[i] = product + OFFSET[i];
        if (!(x[i] >= -DBL_MAX && x[i] <= DBL_MAX)) {
            *status = NOT_FINITE;
            return SAFE;
        }
        if (!PERIODIC[i] && !(x[i] >= LOWER[i] && x[i] <= UPPER[i])) *status = OUTSIDE;
    }
    if (*status == OUTSIDE && !NEAREST) return SAFE;
    for (i = 0; i < STATES; ++i) z[i] = step(i, x[i]);
    RANKS
#ifdef REMEMBERS
    label = label_of(z, now);
#else
    label = label_of(z);
#endif
    if (label == GAP) {
        *status = OUTSIDE;
        return SAFE;
    }
    return label;
}

#ifdef REMEMBERS
static int held(const policy *p, Real since, int hold) {
    return p->time - since < p->times[hold] * (1.0 - 1e-6);
}

/* What is taken where another label than that in force is wanted. Inputs whose time is not over
 * keep their values, if a symbol that may follow has these; where no other is left to change, the
 * label in force stays. */
static int permitted(const policy *p, int wanted) {
    const int now = p->symbol;
    Real mixed[CONTROLS];
    int i, k, whole = 1, stays = 1;
    if (held(p, p->since, HOLD[now])) return now;
    for (i = 0; i < CONTROLS; ++i) {
        mixed[i] = CONTROL[held(p, p->changes[i], INPUT_HOLD[i]) ? now : wanted][i];
        whole = whole && mixed[i] == CONTROL[wanted][i];
        stays = stays && mixed[i] == CONTROL[now][i];
    }
    if (whole) return wanted;
    if (stays) return now;
    for (k = 0; k < LABELS - 1; ++k) {
        for (i = 0; i < CONTROLS && CONTROL[k][i] == mixed[i]; ++i) {}
        if (i < CONTROLS) continue;
        for (i = 0; i < FORBIDDEN && !(NO[i][0] == now && NO[i][1] == k); ++i) {}
        if (i == FORBIDDEN) return k;
    }
    return now;
}

static void decide_now(policy *p) {
    const int first = p->symbol < 0, now = first ? LABELS - 1 : p->symbol;
    int i, waits, symbol = decide(p->inputs, now, &p->status);
    waits = p->status == INSIDE || (p->status == OUTSIDE && !OUTSIDE_AT_ONCE);
    if (first) p->start = p->time;
    if (held(p, p->start, HOLD_OFF)) symbol = SAFE;
    if (!first && waits && KIND[symbol] != KIND[now]) symbol = permitted(p, symbol);
    if (first || KIND[symbol] != KIND[now]) p->since = p->time;
    for (i = 0; i < CONTROLS; ++i) {
        if (first || CONTROL[symbol][i] != CONTROL[now][i]) p->changes[i] = p->time;
    }
    p->symbol = symbol;
    p->changed = 0;
}
#else
static void decide_now(policy *p) {
    const int symbol = decide(p->inputs, &p->status);
    const int waits = p->status == INSIDE || (p->status == OUTSIDE && !OUTSIDE_AT_ONCE);
    int i, same = p->symbol >= 0;
    for (i = 0; same && i < CONTROLS; ++i) same = CONTROL[symbol][i] == CONTROL[p->symbol][i];
    if (same) p->symbol = symbol;
    else if (p->symbol < 0 || !waits || p->time - p->since >= p->dwell * (1.0 - 1e-6)) {
        p->symbol = symbol;
        p->since = p->time;
    }
    p->changed = 0;
}
#endif

/* The outputs now: decided anew where inputs have come since, but taken only by a step. */
static policy seen(const policy *p) {
    policy q = *p;
    if (q.changed || q.symbol < 0) decide_now(&q);
    return q;
}

static void start(policy *p) {
    memset(p, 0, sizeof *p);
#ifdef REMEMBERS
    memcpy(p->times, LEAST, sizeof LEAST);
#else
    p->dwell = DWELL;
#endif
    p->symbol = -1;
    p->changed = 1;
}

FMI(const char *, fmi2GetTypesPlatform)(void) { return "default"; }
FMI(const char *, fmi2GetVersion)(void) { return "2.0"; }
FMI(Status, fmi2SetDebugLogging)(Component c, Boolean on, size_t n, const String categories[]) {
    (void)c; (void)on; (void)n; (void)categories;
    return OK;
}
FMI(Component, fmi2Instantiate)(String name, int type, String guid, String resources,
                                const void *callbacks, Boolean visible, Boolean logging) {
    policy *p;
    (void)name; (void)resources; (void)callbacks; (void)visible; (void)logging;
    if (type != 1 || guid == NULL || strcmp(guid, GUID) != 0) return NULL;
    p = malloc(sizeof *p);
    if (p != NULL) start(p);
    return p;
}
FMI(void, fmi2FreeInstance)(Component c) { free(c); }
FMI(Status, fmi2SetupExperiment)(Component c, Boolean tolerant, Real tolerance, Real begin,
                                 Boolean ends, Real end) {
    (void)tolerant; (void)tolerance; (void)ends; (void)end;
    ((policy *)c)->time = begin;
    return OK;
}
FMI(Status, fmi2EnterInitializationMode)(Component c) { (void)c; return OK; }
FMI(Status, fmi2ExitInitializationMode)(Component c) { (void)c; return OK; }
FMI(Status, fmi2Terminate)(Component c) { (void)c; return OK; }
FMI(Status, fmi2Reset)(Component c) { start(c); return OK; }

FMI(Status, fmi2GetReal)(Component c, const Reference r[], size_t n, Real value[]) {
    const policy p = seen(c);
    size_t k;
    for (k = 0; k < n; ++k) {
        if (r[k] < STATES) value[k] = p.inputs[r[k]];
        else if (r[k] < STATES + CONTROLS) value[k] = CONTROL[p.symbol][r[k] - STATES];
#ifdef REMEMBERS
        else if (r[k] < STATES + CONTROLS + TIMES) value[k] = p.times[r[k] - STATES - CONTROLS];
#else
        else if (r[k] == STATES + CONTROLS) value[k] = p.dwell;
#endif
        else return ERROR;
    }
    return OK;
}
FMI(Status, fmi2SetReal)(Component c, const Reference r[], size_t n, const Real value[]) {
    policy *p = c;
    size_t k;
    for (k = 0; k < n; ++k) {
        if (r[k] < STATES) p->inputs[r[k]] = value[k];
#ifdef REMEMBERS
        else if (r[k] < STATES + CONTROLS || r[k] >= STATES + CONTROLS + TIMES) return ERROR;
        else if (value[k] >= 0.0) p->times[r[k] - STATES - CONTROLS] = value[k];
#else
        else if (r[k] == STATES + CONTROLS && value[k] >= 0.0) p->dwell = value[k];
#endif
        else return ERROR;
    }
    p->changed = 1;
    return OK;
}
FMI(Status, fmi2GetInteger)(Component c, const Reference r[], size_t n, Integer value[]) {
    const policy p = seen(c);
    size_t k;
    for (k = 0; k < n; ++k) {
        if (r[k] > 1u) return ERROR;
        value[k] = r[k] == 0u ? p.symbol : p.status;
    }
    return OK;
}

/* There are no such variables. */
#define NONE(name, type) \
    FMI(Status, name)(Component c, const Reference r[], size_t n, type value[]) { \
        (void)c; (void)r; (void)value; \
        return n == 0u ? OK : ERROR; \
    }
NONE(fmi2GetBoolean, Boolean)
NONE(fmi2GetString, String)
NONE(fmi2SetInteger, const Integer)
NONE(fmi2SetBoolean, const Boolean)
NONE(fmi2SetString, const String)

FMI(Status, fmi2DoStep)(Component c, Real time, Real size, Boolean no_way_back) {
    policy *p = c;
    (void)no_way_back;
    p->time = time;
    decide_now(p);
    p->time = time + size;
    return OK;
}
FMI(Status, fmi2CancelStep)(Component c) { (void)c; return ERROR; }

static Status kept(const policy *p, void **state) {
    if (*state == NULL) *state = malloc(sizeof(policy));
    if (*state == NULL) return ERROR;
    memcpy(*state, p, sizeof(policy));
    return OK;
}
FMI(Status, fmi2GetFMUstate)(Component c, void **state) { return kept(c, state); }
FMI(Status, fmi2SetFMUstate)(Component c, void *state) {
    memcpy(c, state, sizeof(policy));
    return OK;
}
FMI(Status, fmi2FreeFMUstate)(Component c, void **state) {
    (void)c;
    free(*state);
    *state = NULL;
    return OK;
}
FMI(Status, fmi2SerializedFMUstateSize)(Component c, void *state, size_t *size) {
    (void)c; (void)state;
    *size = sizeof(policy);
    return OK;
}
FMI(Status, fmi2SerializeFMUstate)(Component c, void *state, Byte bytes[], size_t size) {
    (void)c;
    if (size < sizeof(policy)) return ERROR;
    memcpy(bytes, state, sizeof(policy));
    return OK;
}
FMI(Status, fmi2DeSerializeFMUstate)(Component c, const Byte bytes[], size_t size, void **state) {
    if (size < sizeof(policy) || kept(c, state) != OK) return ERROR;
    memcpy(*state, bytes, sizeof(policy));
    return OK;
}

/* What the model description says that it cannot do. */
FMI(Status, fmi2GetDirectionalDerivative)(Component c, const Reference of[], size_t n,
                                          const Reference by[], size_t m, const Real seed[],
                                          Real value[]) {
    (void)c; (void)of; (void)n; (void)by; (void)m; (void)seed; (void)value;
    return ERROR;
}
FMI(Status, fmi2SetRealInputDerivatives)(Component c, const Reference r[], size_t n,
                                         const Integer order[], const Real value[]) {
    (void)c; (void)r; (void)n; (void)order; (void)value;
    return ERROR;
}
FMI(Status, fmi2GetRealOutputDerivatives)(Component c, const Reference r[], size_t n,
                                          const Integer order[], Real value[]) {
    (void)c; (void)r; (void)n; (void)order; (void)value;
    return ERROR;
}
#define NO_STATUS(name, type) \
    FMI(Status, name)(Component c, int kind, type *value) { \
        (void)c; (void)kind; (void)value; \
        return DISCARD; \
    }
NO_STATUS(fmi2GetStatus, Status)
NO_STATUS(fmi2GetRealStatus, Real)
NO_STATUS(fmi2GetIntegerStatus, Integer)
NO_STATUS(fmi2GetBooleanStatus, Boolean)
NO_STATUS(fmi2GetStringStatus, String)
