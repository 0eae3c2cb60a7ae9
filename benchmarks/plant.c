/* The drive by fixed-step RK4, closed loop included: what `plant.py` measures against.

   Written for speed as one would write it for one drive: contact law and friction are chosen outside the loop, so that
   the compiler makes one loop for each. */
#include <math.h>

typedef struct {
    double R, L, Km, Jm, Bm, R1, R2, half, Jl, Bl, rub_m, rub_l, limit;
    double c0, c1; /* beta and alpha, or stiffness and damping */
    int n;         /* exponent of the power law; 0: elastic */
} Drive;

static inline double whole_power(double b, int e) {
    double r = 1;
    while (e > 0) {
        if (e & 1) r *= b;
        b *= b;
        e >>= 1;
    }
    return r;
}

static inline double contact(const Drive *p, const double *y, int elastic) {
    double gap = p->R1 * y[0] - p->R2 * y[2], rate = p->R1 * y[1] - p->R2 * y[3];
    if (!elastic) {
        double s = gap / p->half, at = whole_power(s, p->n);
        return p->c0 * at + p->c1 * rate * at * s;
    }
    double depth = fabs(gap) - p->half;
    if (depth <= 0) return 0;
    double side = gap > 0 ? 1 : -1, spring = p->c0 * depth, damper = p->c1 * rate * side;
    if (damper > spring) damper = spring;
    if (damper < -spring) damper = -spring;
    return side * (spring + damper);
}

static inline void slope(const Drive *p, const double *y, double V, double sm, double sl, double *d, int elastic,
                         int rubs) {
    double F = contact(p, y, elastic);
    double on_m = p->Km * y[4] - p->Bm * y[1] - p->R1 * F, on_l = p->R2 * F - p->Bl * y[3];
    if (rubs) {
        on_m = sm == 0 ? 0 : on_m - sm * p->rub_m;
        on_l = sl == 0 ? 0 : on_l - sl * p->rub_l;
    }
    d[0] = y[1];
    d[1] = on_m / p->Jm;
    d[2] = y[3];
    d[3] = on_l / p->Jl;
    d[4] = (V - p->R * y[4] - p->Km * y[1]) / p->L;
}

/* The way a shaft slides: as it turns, or, at rest, where more acts on it than friction holds. */
static inline double slip(double speed, double torque, double rub) {
    if (speed != 0) return speed > 0 ? 1 : -1;
    return torque > rub ? 1 : torque < -rub ? -1 : 0;
}

static inline void play(const Drive *pp, const double *gains, const double *feed, int count, double T, int sub,
                        double *state, double *out, int elastic, int rubs) {
    Drive q = *pp;
    const Drive *p = &q;
    double y[5], a[5], b[5], c[5], d[5], t[5], h = T / sub, sm = 1, sl = 1;
    for (int i = 0; i < 5; i++) y[i] = state[i];
    for (int k = 0; k < count; k++) {
        double V = feed[k] - gains[0] * y[2] - gains[1] * y[3] - gains[2] * y[4];
        V = V > p->limit ? p->limit : V < -p->limit ? -p->limit : V;
        for (int s = 0; s < sub; s++) {
            if (rubs) {
                double F = contact(p, y, elastic);
                sm = slip(y[1], p->Km * y[4] - p->R1 * F, p->rub_m);
                sl = slip(y[3], p->R2 * F, p->rub_l);
            }
            slope(p, y, V, sm, sl, a, elastic, rubs);
            for (int i = 0; i < 5; i++) t[i] = y[i] + 0.5 * h * a[i];
            slope(p, t, V, sm, sl, b, elastic, rubs);
            for (int i = 0; i < 5; i++) t[i] = y[i] + 0.5 * h * b[i];
            slope(p, t, V, sm, sl, c, elastic, rubs);
            for (int i = 0; i < 5; i++) t[i] = y[i] + h * c[i];
            slope(p, t, V, sm, sl, d, elastic, rubs);
            for (int i = 0; i < 5; i++) y[i] += h / 6 * (a[i] + 2 * b[i] + 2 * c[i] + d[i]);
            if (rubs) { /* stop at a reversal */
                if (y[1] * sm < 0) y[1] = 0;
                if (y[3] * sl < 0) y[3] = 0;
            }
        }
        out[k] = y[2];
    }
    for (int i = 0; i < 5; i++) state[i] = y[i];
}

void loop(const Drive *p, const double *gains, const double *feed, int count, double T, int sub, double *state,
          double *out) {
    int rubs = p->rub_m > 0 || p->rub_l > 0;
    if (p->n > 0 && !rubs) play(p, gains, feed, count, T, sub, state, out, 0, 0);
    else if (p->n > 0) play(p, gains, feed, count, T, sub, state, out, 0, 1);
    else if (!rubs) play(p, gains, feed, count, T, sub, state, out, 1, 0);
    else play(p, gains, feed, count, T, sub, state, out, 1, 1);
}
