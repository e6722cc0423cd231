/* Interval arithmetic for programs: bounds of every operation, outward rounding included.
 *
 * Needs the declarations of `real`, `m_NAME` and EACH_LANE before it, and no contraction of
 * products into sums. Each form gives the bounds of the one in `intervals.py`, or wider ones, and
 * is undefined (NaN, NaN) wherever that one is.
 *
 * Outward. Of a double x the distance to its neighbours is at most |x| 2^-52, so that the rounded
 * x - (|x| 2^-52 + 2^-1022) is below x by at least that: rounding is monotone, and the next number
 * down is one. So no rounding mode needs to be set, and loops over lanes stay vectorised.
 */
typedef struct {
    double lo, hi;
} interval;

#define FORM static inline __attribute__((always_inline))
#define ULP 0x1p-52
#define LIBRARY (32 * ULP) /* twice what intervals.py allows, since libraries differ */
#define LARGEST 0x1.fffffffffffffp1023
#define SMALLEST 0x1p-1022
#define PI_UP 0x1.921fb54442d19p+1
#define UNDEFINED ((double)NAN)

FORM double least(double a, double b) { return a < b ? a : b; }
FORM double most(double a, double b) { return a > b ? a : b; }
FORM double size_of(double a) { return a < 0 ? -a : a; } /* NaN stays, and so it does below */
FORM double at_least(double a, double bottom) { return a < bottom ? bottom : a; }
FORM double at_most(double a, double top) { return a > top ? top : a; }

FORM double down(double x, double share)
{
    return at_most(x - (at_most(size_of(x), LARGEST) * share + SMALLEST), LARGEST);
}

FORM double up(double x, double share)
{
    return at_least(x + (at_most(size_of(x), LARGEST) * share + SMALLEST), -LARGEST);
}

FORM interval widened(double lo, double hi, double share)
{
    return (interval){down(lo, share), up(hi, share)};
}

FORM int unknown(interval a) { return (a.lo != a.lo) | (a.hi != a.hi); }
FORM int has_zero(interval a) { return (a.lo <= 0) & (a.hi >= 0); }
FORM int infinite(interval a) { return (size_of(a.lo) > LARGEST) | (size_of(a.hi) > LARGEST); }

FORM interval undefined(int where, interval a)
{
    return (interval){where ? UNDEFINED : a.lo, where ? UNDEFINED : a.hi};
}

FORM interval sound(interval a) { return undefined(unknown(a), a); }

FORM interval clip(interval a, double bottom, double top)
{
    return (interval){at_least(a.lo, bottom), at_most(a.hi, top)};
}

FORM interval clip_sign(interval a, int nonnegative, int nonpositive)
{
    return (interval){nonnegative ? at_least(a.lo, 0) : a.lo, nonpositive ? at_most(a.hi, 0) : a.hi};
}

FORM interval magnitude(interval a)
{
    const double lo = size_of(a.lo), hi = size_of(a.hi);
    return (interval){has_zero(a) ? 0 : least(lo, hi), most(lo, hi)};
}

FORM interval i_neg(interval a) { return (interval){-a.hi, -a.lo}; }

FORM interval i_add(interval a, interval b)
{
    const double lo = a.lo + b.lo, hi = a.hi + b.hi;
    const interval sum = {lo == 0 ? 0 : down(lo, ULP), hi == 0 ? 0 : up(hi, ULP)}; /* 0 is exact */
    const int opposite = ((a.lo < -LARGEST) & (b.hi > LARGEST)) | ((a.hi > LARGEST) & (b.lo < -LARGEST));
    return undefined(opposite, sum);
}

FORM interval i_sub(interval a, interval b) { return i_add(a, i_neg(b)); }

FORM interval corners(double one, double two, double three, double four)
{
    const int bad = (one != one) | (two != two) | (three != three) | (four != four);
    const interval hull = {least(least(one, two), least(three, four)),
                           most(most(one, two), most(three, four))};
    return undefined(bad, hull);
}

/* The sign of a product or quotient is that of its operands, underflow or not. */
FORM interval clip_product(interval r, interval a, interval b)
{
    const int a_up = a.lo >= 0, a_down = a.hi <= 0, b_up = b.lo >= 0, b_down = b.hi <= 0;
    const int zero = (a_up & a_down) | (b_up & b_down);
    return clip_sign(r, (a_up & b_up) | (a_down & b_down) | zero,
                     (a_up & b_down) | (a_down & b_up) | zero);
}

FORM interval i_mul(interval a, interval b)
{
    const interval r = corners(a.lo * b.lo, a.lo * b.hi, a.hi * b.lo, a.hi * b.hi);
    const int bad = (has_zero(a) & infinite(b)) | (has_zero(b) & infinite(a));
    return undefined(bad, clip_product(widened(r.lo, r.hi, ULP), a, b));
}

FORM interval i_square(interval a)
{
    const interval size = magnitude(a);
    return clip_sign(widened(size.lo * size.lo, size.hi * size.hi, ULP), 1, size.hi == 0);
}

FORM interval i_div(interval a, interval b)
{
    const interval r = corners(a.lo / b.lo, a.lo / b.hi, a.hi / b.lo, a.hi / b.hi);
    return undefined(has_zero(b), clip_product(widened(r.lo, r.hi, ULP), a, b));
}

FORM interval i_fabs(interval a) { return magnitude(a); }
FORM interval i_floor(interval a) { return (interval){floor(a.lo), floor(a.hi)}; }
FORM interval i_ceil(interval a) { return (interval){ceil(a.lo), ceil(a.hi)}; }
FORM double sign_of(double a) { return a > 0 ? 1 : a < 0 ? -1 : a; }
FORM interval i_sign(interval a) { return (interval){sign_of(a.lo), sign_of(a.hi)}; }

FORM interval i_copysign(interval a, interval b)
{
    const interval size = magnitude(a);
    return (interval){b.lo > 0 ? size.lo : -size.hi, b.hi < 0 ? -size.lo : size.hi};
}

FORM interval i_fmin(interval a, interval b)
{
    return (interval){least(a.lo, b.lo), least(a.hi, b.hi)};
}

FORM interval i_fmax(interval a, interval b)
{
    return (interval){most(a.lo, b.lo), most(a.hi, b.hi)};
}

FORM interval truth(interval a)
{
    return (interval){has_zero(a) ? 0 : 1, (a.lo == 0) & (a.hi == 0) ? 0 : 1};
}

FORM interval known(int certain, int impossible)
{
    return (interval){certain ? 1 : 0, impossible ? 0 : 1};
}

FORM interval i_not(interval a)
{
    const interval t = truth(a);
    return (interval){1 - t.hi, 1 - t.lo};
}

FORM interval i_lt(interval a, interval b) { return known(a.hi < b.lo, a.lo >= b.hi); }
FORM interval i_le(interval a, interval b) { return known(a.hi <= b.lo, a.lo > b.hi); }

FORM interval i_eq(interval a, interval b)
{
    return known((a.lo == b.hi) & (a.hi == b.lo), (a.hi < b.lo) | (a.lo > b.hi));
}

FORM interval i_ne(interval a, interval b) { return i_not(i_eq(a, b)); }
FORM interval i_and(interval a, interval b) { return i_fmin(truth(a), truth(b)); }
FORM interval i_or(interval a, interval b) { return i_fmax(truth(a), truth(b)); }

FORM interval i_select(interval condition, interval a)
{
    const interval t = truth(condition);
    const int never = t.hi == 0, always = t.lo == 1;
    const interval r = {never ? 0 : always ? a.lo : at_most(a.lo, 0),
                        never ? 0 : always ? a.hi : at_least(a.hi, 0)};
    return undefined((condition.lo != condition.lo) | (!never & unknown(a)), r);
}

/* The bounds of `a` where the condition holds, else of `b`; of both where it may. */
FORM interval i_either(interval condition, interval a, interval b)
{
    const interval t = truth(condition);
    const int never = t.hi == 0, always = t.lo == 1;
    const interval r = {never ? b.lo : always ? a.lo : least(a.lo, b.lo),
                        never ? b.hi : always ? a.hi : most(a.hi, b.hi)};
    const int bad = (!never & unknown(a)) | (!always & unknown(b)) | unknown(condition);
    return undefined(bad, r);
}

/* A library function that rises; `zero` is where it changes sign, `bottom` and `top` bound it. */
FORM interval rising(double lo, double hi, interval a, double zero, double bottom, double top)
{
    const interval r = undefined((lo != lo) | (hi != hi), widened(lo, hi, LIBRARY));
    return clip(clip_sign(r, a.lo >= zero, a.hi <= zero), bottom, top);
}

/* The same, undefined where it is infinite at a finite argument. */
FORM interval with_poles(double lo, double hi, interval a, double zero)
{
    const int pole = ((size_of(lo) > LARGEST) & (size_of(a.lo) <= LARGEST))
                     | ((size_of(hi) > LARGEST) & (size_of(a.hi) <= LARGEST));
    return undefined(pole, rising(lo, hi, a, zero, -INFINITY, INFINITY));
}

/* Where the interval may hold a point (k + phase) period, rounding included. */
FORM int reaches(interval a, double period, double phase)
{
    double lo = a.lo / period - phase, hi = a.hi / period - phase;
    lo -= 2e-15 * (1 + size_of(lo));
    hi += 2e-15 * (1 + size_of(hi));
    return (floor(hi) >= ceil(lo)) | (most(size_of(a.lo), size_of(a.hi)) > 1e8);
}

FORM interval wave(double one, double two, interval a, double peak)
{
    const double turn = 0x1.921fb54442d18p+2;
    interval r = undefined((one != one) | (two != two),
                           widened(least(one, two), most(one, two), LIBRARY));
    r.lo = reaches(a, turn, peak + 0.5) ? -1 : r.lo;
    r.hi = reaches(a, turn, peak) ? 1 : r.hi;
    return undefined(infinite(a) | unknown(a), clip(r, -1, 1));
}

/* With the sign of the argument up to `reach`, which widening would lose. */
FORM interval odd(interval r, interval a, double reach)
{
    return clip_sign(r, (a.lo >= 0) & (a.hi <= reach), (a.lo >= -reach) & (a.hi <= 0));
}

FORM interval poles_of_tan(double lo, double hi, interval a)
{
    const int bad = reaches(a, 0x1.921fb54442d18p+1, 0.5) | infinite(a) | unknown(a);
    return odd(undefined(bad, rising(lo, hi, a, UNDEFINED, -INFINITY, INFINITY)), a, 1.5);
}

FORM interval angle(interval r, interval y, interval x)
{
    const interval w = undefined(unknown(r), widened(r.lo, r.hi, LIBRARY));
    const interval s = clip_sign(w, y.lo >= 0, y.hi <= 0);
    const int branch = has_zero(y) & (x.lo <= 0); /* the jump at the negative axis, the origin */
    const interval full = {branch ? -PI_UP : s.lo, branch ? PI_UP : s.hi};
    return clip(full, -PI_UP, PI_UP);
}

FORM interval length(double lo, double hi, interval a, interval b)
{
    return clip_sign(widened(lo, hi, LIBRARY), 1, (a.hi == 0) & (b.hi == 0));
}

FORM int is_whole(interval b) { return (b.lo == b.hi) & (rint(b.lo) == b.lo); }
FORM int is_even(interval b) { return is_whole(b) & (2 * trunc(b.lo / 2) == b.lo); }

/* The base whose powers are monotone: its size, where the exponent is even. */
FORM interval base_of(interval a, interval b)
{
    const interval size = magnitude(a);
    return (interval){is_even(b) ? size.lo : a.lo, is_even(b) ? size.hi : a.hi};
}

FORM interval power(interval r, interval base, interval b)
{
    const int whole = is_whole(b), uneven = whole & !is_even(b);
    const interval w = undefined(unknown(r), widened(r.lo, r.hi, LIBRARY));
    const interval s = clip_sign(w, base.lo >= 0, uneven & (base.hi <= 0));
    const int at_zero = has_zero(base) & (whole ? b.lo < 0 : b.lo <= 0);
    return undefined(at_zero | (!whole & (base.lo < 0)) | infinite(b), s);
}

FORM interval i_fmod(interval a, interval b)
{
    const interval size = magnitude(a), divisor = magnitude(b), quotient = i_div(a, divisor);
    const double lo = trunc(quotient.lo), hi = trunc(quotient.hi);
    const double bound = least(size.hi, divisor.hi);
    const interval whole = {a.lo < 0 ? -bound : 0, a.hi > 0 ? bound : 0};
    const interval step = {lo, lo};
    const interval rest = clip(i_sub(a, i_mul(step, divisor)), whole.lo, whole.hi);
    const int same = lo == hi;
    const interval r = {same ? rest.lo : whole.lo, same ? rest.hi : whole.hi};
    return undefined((lo != lo) | infinite(a), r);
}

FORM interval i_remainder(interval a, interval b)
{
    const interval quotient = i_div(a, b);
    const double lo = rint(quotient.lo), hi = rint(quotient.hi);
    const interval step = {lo, lo}, rest = i_sub(a, i_mul(step, b));
    const double size = magnitude(a).hi;
    /* rounding of a - b k beside a k that is off by rounding near a tie */
    const double bound = magnitude(b).hi / 2 * (1 + 8 * ULP) + 8 * ULP * size;
    const int same = lo == hi, overflow = !(size_of(lo + hi) <= LARGEST) | (1.1 * size > LARGEST);
    const interval r = {same ? rest.lo : -bound, same ? rest.hi : bound};
    return undefined(overflow | infinite(b), r);
}

/* The bounds of a / (a a + c)^(1 / 2^roots), which rises. */
FORM interval i_smoothed(interval a, double c, int roots)
{
    interval low = {a.lo, a.lo}, high = {a.hi, a.hi}, one = i_add(i_square(low), (interval){c, c}),
             two = i_add(i_square(high), (interval){c, c});
    for (int k = 0; k < roots; ++k) {
        one = rising(sqrt(one.lo), sqrt(one.hi), one, 0, 0, INFINITY);
        two = rising(sqrt(two.lo), sqrt(two.hi), two, 0, 0, INFINITY);
    }
    low = i_div(low, one), high = i_div(high, two);
    return undefined(unknown(low) | unknown(high), (interval){low.lo, high.hi});
}
