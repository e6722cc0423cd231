/* Sets of any number of states: boxes, lower ends first; the functions are those of polygon.c. */
#define SHAPE_SIZE (2 * STATES)

typedef struct {
    int32_t count;
    double v[SHAPE_SIZE];
} shape;

static void box_shape(const double *lower, const double *upper, shape *s)
{
    s->count = 2;
    memcpy(s->v, lower, STATES * sizeof(double));
    memcpy(s->v + STATES, upper, STATES * sizeof(double));
}

static void bounds_of(const shape *s, double *lower, double *upper)
{
    memcpy(lower, s->v, STATES * sizeof(double));
    memcpy(upper, s->v + STATES, STATES * sizeof(double));
}

static void along(const shape *s, const double *a, double *least, double *most)
{
    *least = *most = 0;
    for (int i = 0; i < STATES; ++i) {
        *least += a[i] * s->v[a[i] > 0 ? i : STATES + i];
        *most += a[i] * s->v[a[i] > 0 ? STATES + i : i];
    }
}

static double size_of_shape(const shape *s)
{
    double size = 1;
    for (int i = 0; i < STATES; ++i)
        size *= s->v[STATES + i] - s->v[i];
    return size;
}

static int cut_off(const shape *s, const double *a, const double limit, shape *out)
{
    double least, most;
    along(s, a, &least, &most);
    *out = *s;
    for (int i = 0; i < STATES; ++i) { /* the others at their best leave this much for one */
        const double low = s->v[i], high = s->v[STATES + i];
        if (a[i] == 0)
            continue;
        const double others = least - a[i] * (a[i] > 0 ? low : high);
        const double at = (limit - others) / a[i];
        if (a[i] > 0)
            out->v[STATES + i] = lesser(high, greater(at + SLACK * (fabs(at) + fabs(others / a[i])), low));
        else
            out->v[i] = greater(low, lesser(at - SLACK * (fabs(at) + fabs(others / a[i])), high));
    }
    return least <= limit;
}

static void transform(shape *s, const double *M, const double *b)
{
    double middle[STATES], half[STATES];
    for (int i = 0; i < STATES; ++i) {
        middle[i] = s->v[i] / 2 + s->v[STATES + i] / 2;
        half[i] = s->v[STATES + i] / 2 - s->v[i] / 2;
    }
    for (int i = 0; i < STATES; ++i) {
        double at = b[i], wide = 0;
        for (int j = 0; j < STATES; ++j) {
            at += M[i * STATES + j] * middle[j];
            wide += fabs(M[i * STATES + j]) * half[j];
        }
        s->v[i] = at - wide, s->v[STATES + i] = at + wide;
    }
}

static void hull(const shape *a, const shape *b, shape *out)
{
    out->count = 2;
    for (int i = 0; i < STATES; ++i) {
        out->v[i] = lesser(a->v[i], b->v[i]);
        out->v[STATES + i] = greater(a->v[STATES + i], b->v[STATES + i]);
    }
}
