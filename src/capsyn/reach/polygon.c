/* Sets of two states: convex polygons, vertices counterclockwise.
 *
 * A piece is `shape` widened by an error box. What rounding takes from a polygon is at most a few
 * hundred units in the last place of its largest coordinate, and whoever calls adds `SLACK` of that
 * to the error. Half-planes are widened before they cut, so that no sliver is lost where an edge is
 * nearly parallel to the cut.
 */
#define SHAPE_SIZE (2 * MOST_VERTICES)

typedef struct {
    int32_t count;
    double v[SHAPE_SIZE];
} shape;

static void box_shape(const double *lower, const double *upper, shape *s)
{
    const double corners[8] = {lower[0], lower[1], upper[0], lower[1],
                               upper[0], upper[1], lower[0], upper[1]};
    s->count = 4;
    memcpy(s->v, corners, sizeof corners);
}

static void bounds_of(const shape *s, double *lower, double *upper)
{
    for (int i = 0; i < 2; ++i)
        lower[i] = upper[i] = s->v[i];
    for (int k = 1; k < s->count; ++k)
        for (int i = 0; i < 2; ++i) {
            lower[i] = lesser(lower[i], s->v[2 * k + i]);
            upper[i] = greater(upper[i], s->v[2 * k + i]);
        }
}

static void along(const shape *s, const double *a, double *least, double *most)
{
    *least = INFINITY, *most = -INFINITY;
    for (int k = 0; k < s->count; ++k) {
        const double value = a[0] * s->v[2 * k] + a[1] * s->v[2 * k + 1];
        *least = lesser(*least, value), *most = greater(*most, value);
    }
}

static double cross(const double *o, const double *a, const double *b)
{
    return (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0]);
}

/* Twice the area. */
static double size_of_shape(const shape *s)
{
    double area = 0;
    for (int k = 1; k + 1 < s->count; ++k)
        area += cross(s->v, s->v + 2 * k, s->v + 2 * k + 2);
    return area;
}

/* Where the lines of the edges before and after edge k meet, beyond it; 0 where they do not. */
static int apex(const double *v, const int n, const int k, double *p)
{
    const double *a = v + 2 * ((k + n - 1) % n), *b = v + 2 * k;
    const double *c = v + 2 * ((k + 1) % n), *d = v + 2 * ((k + 2) % n);
    const double u[2] = {b[0] - a[0], b[1] - a[1]}, w[2] = {c[0] - d[0], c[1] - d[1]};
    const double turn = w[0] * u[1] - w[1] * u[0]; /* of w to u: both run towards the apex */
    if (!(turn > 1e-6 * (hypot(u[0], u[1]) * hypot(w[0], w[1]))))
        return 0;
    const double along_u = ((c[1] - b[1]) * w[0] - (c[0] - b[0]) * w[1]) / turn;
    const double along_w = ((c[1] - b[1]) * u[0] - (c[0] - b[0]) * u[1]) / turn;
    p[0] = b[0] + along_u * u[0], p[1] = b[1] + along_u * u[1];
    return along_u >= 0 && along_w >= 0 && isfinite(p[0]) && isfinite(p[1]);
}

/* Keep n vertices, or fewer around them: edges are taken away where that adds least. */
static void keep_few(double *v, int n, shape *s)
{
    while (n > MOST_VERTICES) {
        double least = INFINITY, p[2], best[2] = {0, 0};
        int which = -1;
        for (int k = 0; k < n; ++k)
            if (apex(v, n, k, p)) {
                const double added = fabs(cross(v + 2 * k, v + 2 * ((k + 1) % n), p));
                if (added < least)
                    least = added, which = k, memcpy(best, p, sizeof best);
            }
        if (which < 0) { /* no two edges meet: the box holds all */
            double lower[2] = {v[0], v[1]}, upper[2] = {v[0], v[1]};
            for (int k = 2; k < 2 * n; ++k) {
                lower[k % 2] = lesser(lower[k % 2], v[k]);
                upper[k % 2] = greater(upper[k % 2], v[k]);
            }
            box_shape(lower, upper, s);
            return;
        }
        memcpy(v + 2 * which, best, sizeof best);
        const int gone = (which + 1) % n;
        memmove(v + 2 * gone, v + 2 * gone + 2, sizeof(double) * 2 * (n - gone - 1));
        --n;
    }
    s->count = n;
    memcpy(s->v, v, sizeof(double) * 2 * n);
}

/* What of a shape has a . x <= limit; whether there is any. */
static int cut_off(const shape *s, const double *a, const double limit, shape *out)
{
    const int n = s->count;
    double value[MOST_VERTICES], v[2 * (2 * MOST_VERTICES)];
    int kept = 0;
    for (int k = 0; k < n; ++k)
        value[k] = a[0] * s->v[2 * k] + a[1] * s->v[2 * k + 1] - limit;
    for (int k = 0; k < n; ++k) {
        const int next = (k + 1) % n;
        const double *p = s->v + 2 * k, *q = s->v + 2 * next;
        if (value[k] <= 0)
            memcpy(v + 2 * kept++, p, 2 * sizeof(double));
        if ((value[k] <= 0) != (value[next] <= 0)) {
            const double t = value[k] / (value[k] - value[next]);
            for (int i = 0; i < 2; ++i)
                v[2 * kept + i] = p[i] + t * (q[i] - p[i]);
            ++kept;
        }
    }
    keep_few(v, kept, out);
    return kept > 0;
}

/* s <- M s + b. */
static void transform(shape *s, const double *M, const double *b)
{
    for (int k = 0; k < s->count; ++k) {
        double *x = s->v + 2 * k;
        const double y[2] = {M[0] * x[0] + M[1] * x[1] + b[0], M[2] * x[0] + M[3] * x[1] + b[1]};
        memcpy(x, y, sizeof y);
    }
}

/* The convex hull of two, by the monotone chain, of few vertices. */
static void hull(const shape *a, const shape *b, shape *out)
{
    double p[2 * MOST_VERTICES][2], v[2 * (2 * MOST_VERTICES + 1)];
    const int n = a->count + b->count;
    for (int k = 0; k < n; ++k) { /* in order of the first state, then the second */
        const double *x = k < a->count ? a->v + 2 * k : b->v + 2 * (k - a->count);
        int at = k;
        for (; at > 0 && (p[at - 1][0] > x[0] || (p[at - 1][0] == x[0] && p[at - 1][1] > x[1])); --at)
            p[at][0] = p[at - 1][0], p[at][1] = p[at - 1][1];
        p[at][0] = x[0], p[at][1] = x[1];
    }
    int kept = 0;
    for (int turn = 0, floor_ = 1; turn < 2; ++turn) {
        for (int k = turn; k < n; ++k) {
            const double *x = p[turn ? n - 1 - k : k];
            while (kept > floor_ && cross(v + 2 * kept - 4, v + 2 * kept - 2, x) <= 0)
                --kept;
            memcpy(v + 2 * kept++, x, 2 * sizeof(double));
        }
        floor_ = kept;
    }
    keep_few(v, kept > 1 ? kept - 1 : kept, out);
}
