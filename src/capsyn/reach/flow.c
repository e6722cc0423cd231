/* Where the states of a piece are after a time under one control: enclosures of solutions.
 *
 * Needs `shape` and its functions, and the programs `rates`, `slopes`, `breaks` as bounds over
 * boxes: rates f(x, u, p), the Jacobian of f by rows, and the conditions at which f may jump. The
 * states from MOVING on are exogenous inputs, whose rates are 0 in all programs.
 */
#define ORDER 8   /* of the Taylor series of the flow of a linear system */
#define PARTS 32  /* most parts of a box in which a bound is looked for */
#define TIGHT 0.02 /* share of a bound by which it may be loose */

typedef struct {
    double lower[STATES], upper[STATES];
} box;

/* All inputs of the programs over a box: states, control, parameters. */
typedef struct {
    double ends[2][INPUTS][1];
} arguments;

static void put(arguments *a, const box *b)
{
    for (int i = 0; i < STATES; ++i)
        a->ends[0][i][0] = b->lower[i], a->ends[1][i][0] = b->upper[i];
}

#define BOUNDS(program, a, out) \
    program((const double (*)[1])(a)->ends[0], (const double (*)[1])(a)->ends[1], (out)[0], (out)[1])

/* Rates over a box; whether all are finite. */
static int rates_over(arguments *a, const box *b, double *lower, double *upper)
{
    double out[2][STATES][1];
    put(a, b);
    BOUNDS(rates, a, out);
    int known = 1;
    for (int i = 0; i < STATES; ++i) {
        lower[i] = i < MOVING ? out[0][i][0] : 0, upper[i] = i < MOVING ? out[1][i][0] : 0;
        known &= isfinite(lower[i]) && isfinite(upper[i]);
    }
    return known;
}

static double slack(const double x) { return fabs(x) * SLACK; }

/* A box that holds the solutions from a box for a time, and their rates; 0 where none is found.
 *
 * If x + [0, t] f(B) lies in B for all x of the start, solutions stay in B (Picard). */
static int tube(arguments *a, const box *start, const double time, box *b, double *lower,
                double *upper)
{
    if (!rates_over(a, start, lower, upper))
        return 0;
    for (int attempt = 0; attempt < 12; ++attempt) {
        for (int i = 0; i < STATES; ++i) {
            const double more = attempt ? 0.1 * (upper[i] - lower[i]) : 0;
            const double low = time * lesser(lower[i] - more, 0), high = time * greater(upper[i] + more, 0);
            b->lower[i] = start->lower[i] + low - 4 * (slack(low) + slack(start->lower[i]));
            b->upper[i] = start->upper[i] + high + 4 * (slack(high) + slack(start->upper[i]));
        }
        if (!rates_over(a, b, lower, upper))
            return 0;
        int inside = 1;
        for (int i = 0; i < STATES; ++i) {
            const double low = time * lesser(lower[i], 0), high = time * greater(upper[i], 0);
            inside &= start->lower[i] + low - slack(low) - slack(start->lower[i]) >= b->lower[i];
            inside &= start->upper[i] + high + slack(high) + slack(start->upper[i]) <= b->upper[i];
        }
        if (inside)
            return 1;
    }
    return 0;
}

/* y <- the sum over k = 1 .. ORDER of t^k / k! |J|^(k - 1) v; returns what the rest of the series
 * is at most, over the widths w, NaN where nothing is known.
 *
 * It is the most that |z| grows to in a time t if |z'| <= |J| |z| + v. */
static double series(const double *J, const double *v, const double *w, const double time,
                     double *y)
{
    double term[STATES], norm = 0, size = 0;
    for (int i = 0; i < STATES; ++i)
        y[i] = term[i] = time * v[i];
    for (int k = 2; k <= ORDER; ++k) {
        double next[STATES];
        for (int i = 0; i < STATES; ++i) {
            next[i] = 0;
            for (int j = 0; j < STATES; ++j)
                next[i] += fabs(J[i * STATES + j]) * term[j] * time / k;
        }
        for (int i = 0; i < STATES; ++i)
            y[i] += term[i] = next[i];
    }
    for (int i = 0; i < STATES; ++i) {
        double row = 0;
        for (int j = 0; j < STATES; ++j)
            row += fabs(J[i * STATES + j]) * w[j];
        norm = greater(norm, row / w[i]), size = greater(size, term[i] / w[i]);
    }
    const double ratio = 1.001 * time * norm / (ORDER + 1); /* of each term to the one before */
    return ratio < 0.5 ? 1.001 * size * ratio / (1 - ratio) : NAN;
}

/* f in a tube as an affine map, F + J (x - middle) +- rest; 0 where it is none. */
static int linearised(arguments *a, const box *b, double *middle, double *F, double *J, double *rest)
{
    double out[2][STATES * STATES][1], conditions[2][BREAKS][1], low[STATES], high[STATES];
    box at;
    put(a, b);
    BOUNDS(breaks, a, conditions);
    for (int k = 0; k < BREAKS; ++k)
        if (!(conditions[0][k][0] == conditions[1][k][0]))
            return 0; /* f may jump */
    BOUNDS(slopes, a, out);
    for (int i = 0; i < STATES; ++i)
        at.lower[i] = at.upper[i] = middle[i] = b->lower[i] / 2 + b->upper[i] / 2;
    if (!rates_over(a, &at, low, high))
        return 0;
    for (int i = 0; i < STATES; ++i) {
        F[i] = low[i] / 2 + high[i] / 2;
        rest[i] = (high[i] - low[i]) / 2 + slack(low[i]) + slack(high[i]);
        for (int j = 0; j < STATES; ++j) {
            const double least = i < MOVING ? out[0][i * STATES + j][0] : 0;
            const double most = i < MOVING ? out[1][i * STATES + j][0] : 0;
            const double half = greater(middle[j] - b->lower[j], b->upper[j] - middle[j]);
            J[i * STATES + j] = least / 2 + most / 2;
            rest[i] += ((most - least) / 2 + slack(least) + slack(most)) * half;
        }
        if (!isfinite(rest[i]))
            return 0;
    }
    return 1;
}

/* Move a shape and its error along the affine system that f is near to in the tube.
 *
 * Solutions of that system are x + phi (F + J (x - middle)), phi = t I + t^2 / 2 J + ..; those of f
 * stray from them by the series of `rest`. */
static int flow_affine(arguments *a, const box *b, const double *w, const double time, shape *s,
                       double *error)
{
    double middle[STATES], F[STATES], J[STATES * STATES], rest[STATES];
    double phi[STATES * STATES] = {0}, M[STATES * STATES], shift[STATES];
    double rate[STATES], strayed[STATES], terms[STATES], grown[STATES], size[STATES], far[STATES];
    if (!linearised(a, b, middle, F, J, rest))
        return 0;
    for (int k = ORDER; k >= 1; --k) { /* Horner's rule */
        double next[STATES * STATES];
        for (int i = 0; i < STATES; ++i)
            for (int j = 0; j < STATES; ++j) {
                double sum = i == j;
                for (int l = 0; l < STATES; ++l)
                    sum += J[i * STATES + l] * phi[l * STATES + j];
                next[i * STATES + j] = sum * time / k;
            }
        memcpy(phi, next, sizeof phi);
    }
    for (int i = 0; i < STATES; ++i)
        far[i] = greater(fabs(b->lower[i]), fabs(b->upper[i]));
    for (int i = 0; i < STATES; ++i) {
        rate[i] = fabs(F[i]), shift[i] = 0, grown[i] = 0, size[i] = 0;
        for (int j = 0; j < STATES; ++j) {
            double sum = 0;
            for (int l = 0; l < STATES; ++l)
                sum += phi[i * STATES + l] * J[l * STATES + j];
            M[i * STATES + j] = (i == j) + sum;
            shift[i] += phi[i * STATES + j] * F[j] - sum * middle[j];
            rate[i] += fabs(J[i * STATES + j])
                * greater(middle[j] - b->lower[j], b->upper[j] - middle[j]);
            size[i] += fabs(sum * middle[j]);
        }
        for (int j = 0; j < STATES; ++j) {
            grown[i] += fabs(M[i * STATES + j]) * error[j];
            size[i] += fabs(M[i * STATES + j]) * far[j] + fabs(phi[i * STATES + j] * F[j]);
        }
    }
    const double left = series(J, rest, w, time, strayed) + series(J, rate, w, time, terms);
    if (!(left < 1))
        return 0;
    transform(s, M, shift);
    for (int i = 0; i < STATES; ++i)
        error[i] = (grown[i] + strayed[i] + w[i] * left) * (1 + 1e-9) + 4 * slack(size[i]);
    return 1;
}

/* What one rate is at most over a box, or at least: the most with its sign turned. */
static double rate_over(arguments *a, const box *b, const int axis, const double sign)
{
    double low[STATES], high[STATES];
    return !rates_over(a, b, low, high) ? INFINITY : sign > 0 ? high[axis] : -low[axis];
}

/* The same, by parts where that is loose: the part with the most is halved. */
static double most_rate(arguments *a, const box *whole, const int axis, const double sign)
{
    box part[PARTS];
    double most[PARTS], known = -INFINITY;
    part[0] = *whole, most[0] = rate_over(a, whole, axis, sign);
    for (int count = 1;; ++count) {
        int top = 0, widest = 0;
        for (int k = 1; k < count; ++k)
            if (most[k] > most[top])
                top = k;
        box at;
        for (int i = 0; i < STATES; ++i)
            at.lower[i] = at.upper[i] = part[top].lower[i] / 2 + part[top].upper[i] / 2;
        const double here = rate_over(a, &at, axis, sign);
        known = here < INFINITY ? greater(known, here) : known;
        if (count == PARTS || (most[top] < INFINITY && most[top] - known <= TIGHT * fabs(most[top])))
            return most[top];
        double share = 0;
        for (int i = 0; i < STATES; ++i) {
            const double width = part[top].upper[i] - part[top].lower[i];
            const double full = whole->upper[i] - whole->lower[i];
            if (width > share * full)
                share = width / full, widest = i;
        }
        part[count] = part[top];
        part[top].upper[widest] = part[count].lower[widest] = at.lower[widest];
        most[top] = rate_over(a, &part[top], axis, sign);
        most[count] = rate_over(a, &part[count], axis, sign);
    }
}

/* The box after a time, by its faces: each moves at the largest rate in the slab that states near
 * it can be in meanwhile. */
static void flow_faces(arguments *a, const box *start, const box *b, const double *lower,
                       const double *upper, const double time, box *out)
{
    for (int i = 0; i < STATES; ++i) {
        const double reach = time * greater(fabs(lower[i]), fabs(upper[i])) * (1 + 1e-9);
        for (int side = 0; side < 2; ++side) {
            const double sign = side ? 1 : -1, face = side ? start->upper[i] : start->lower[i];
            box slab = *b;
            slab.lower[i] = greater(b->lower[i], face - reach - slack(face));
            slab.upper[i] = lesser(b->upper[i], face + reach + slack(face));
            const double rate = i < MOVING ? most_rate(a, &slab, i, sign) : 0;
            const double moved = greater(sign * face - reach, sign * face + time * rate);
            const double safe = moved + 4 * (slack(face) + slack(reach) + slack(time * rate));
            if (side)
                out->upper[i] = lesser(safe, b->upper[i]);
            else
                out->lower[i] = greater(-safe, b->lower[i]);
        }
    }
}

#define POOR 0.02 /* of the width: an error from one flow that faces may better */

/* Move a shape and its error for a time; `b` gets the tube. 0 where no enclosure is found. */
static int flow(arguments *a, const double *w, const double time, shape *s, double *error, box *b)
{
    box start, end;
    double lower[STATES], upper[STATES], poor = 0;
    bounds_of(s, start.lower, start.upper);
    for (int i = 0; i < STATES; ++i)
        start.lower[i] -= error[i], start.upper[i] += error[i];
    if (!tube(a, &start, time, b, lower, upper))
        return 0;
    shape moved = *s;
    double grown[STATES];
    memcpy(grown, error, sizeof grown);
    const int affine = flow_affine(a, b, w, time, &moved, grown);
    for (int i = 0; affine && i < STATES; ++i)
        poor = greater(poor, (grown[i] - error[i]) / (start.upper[i] - start.lower[i] + 1e-3 * w[i]));
    if (!affine || poor > POOR) {
        flow_faces(a, &start, b, lower, upper, time, &end);
        double wide_affine = 0, wide_faces = 0, low[STATES], high[STATES];
        bounds_of(&moved, low, high);
        for (int i = 0; i < STATES; ++i) {
            wide_affine += (high[i] - low[i] + 2 * grown[i]) / w[i];
            wide_faces += (end.upper[i] - end.lower[i]) / w[i];
        }
        if (!affine || wide_faces < wide_affine) {
            box_shape(end.lower, end.upper, s);
            for (int i = 0; i < STATES; ++i)
                error[i] = 4 * slack(greater(fabs(end.lower[i]), fabs(end.upper[i])));
            return 1;
        }
    }
    *s = moved;
    memcpy(error, grown, sizeof grown);
    return 1;
}
