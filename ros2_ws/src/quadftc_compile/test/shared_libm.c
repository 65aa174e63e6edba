/* What laws take of libm, in plain arithmetic: the same on every processor. Not exact to the last bit, and
   meant for tests alone. -DSINGLE gives the functions of float. */
#ifdef SINGLE
typedef float real;
#define NAMED(name) name##f
#else
typedef double real;
#define NAMED(name) name
#endif

real NAMED(sqrt)(real x); /* of libm: correctly rounded everywhere */
real NAMED(sin)(real x);
real NAMED(cos)(real x);
real NAMED(tan)(real x);
real NAMED(atan2)(real y, real x);
real NAMED(asin)(real x);
real NAMED(exp)(real x);
real NAMED(log)(real x);

static const real HALF_PI = (real)1.5707963267948966, LN2 = (real)0.6931471805599453;

/* Sum of a power series in x^2: c0 x (1 + c1 x^2 (1 + c2 x^2 (...))), alternating where sign is -1. */
static real series(real x, int terms, real sign, real (*ratio)(int))
{
    real sum = 1;
    for (int k = terms; k > 0; k--) sum = 1 + sign * x * ratio(k) * sum;
    return sum;
}

static real sine_ratio(int k) { return (real)1 / (real)((2 * k) * (2 * k + 1)); }
static real cosine_ratio(int k) { return (real)1 / (real)((2 * k) * (2 * k - 1)); }
static real odd_ratio(int k) { return (real)(2 * k - 1) / (real)(2 * k + 1); }
static real factor_ratio(int k) { return (real)1 / (real)k; }

/* sin(x + quarters pi/2) */
static real wave(real x, int quarters)
{
    if (!(x - x == 0)) return x - x;
    const real turns = x / HALF_PI;
    const long k = (long)(turns + (turns < 0 ? (real)-0.5 : (real)0.5));
    const real rest = x - (real)k * HALF_PI;
    const long quarter = ((k + quarters) % 4 + 4) % 4;
    const real value = quarter % 2 ? series(rest * rest, 12, -1, cosine_ratio)
                                   : rest * series(rest * rest, 12, -1, sine_ratio);
    return quarter < 2 ? value : -value;
}

static real arctangent(real x)
{
    if (x > 1 || x < -1) return (x > 0 ? HALF_PI : -HALF_PI) - arctangent(1 / x);
    int doubled = 0;
    for (; doubled < 2; doubled++) x = x / (1 + NAMED(sqrt)(1 + x * x));
    return 4 * x * series(x * x, 12, -1, odd_ratio);
}

real NAMED(sin)(real x) { return wave(x, 0); }
real NAMED(cos)(real x) { return wave(x, 1); }
real NAMED(tan)(real x) { return wave(x, 0) / wave(x, 1); }

real NAMED(atan2)(real y, real x)
{
    if (y == 0) return x < 0 ? 2 * HALF_PI : y;
    if (x == 0) return y > 0 ? HALF_PI : -HALF_PI;
    const real angle = arctangent(y / x);
    return x > 0 ? angle : y > 0 ? angle + 2 * HALF_PI : angle - 2 * HALF_PI;
}

real NAMED(asin)(real x) { return NAMED(atan2)(x, NAMED(sqrt)((1 - x) * (1 + x))); }

real NAMED(exp)(real x)
{
    if (!(x > -80)) return x != x ? x : 0;
    if (x > 80) x = 80;
    int halvings = 0;
    for (; x > (real)0.5 || x < (real)-0.5; halvings++) x = x / 2;
    real value = series(x, 14, 1, factor_ratio);
    for (; halvings > 0; halvings--) value = value * value;
    return value;
}

real NAMED(log)(real x)
{
    if (!(x > 0) || x - x != 0) return x == 0 ? -80 : x - x;
    int twos = 0;
    for (; x > (real)1.5; twos++) x = x / 2;
    for (; x < (real)0.75; twos--) x = x * 2;
    const real ratio = (x - 1) / (x + 1);
    return (real)twos * LN2 + 2 * ratio * series(ratio * ratio, 24, 1, odd_ratio);
}
