/* The EKF of bcid.estimate in C, as one would write it from the equations: dense 7 x 7 matrices, RK4 on mean, covariance
   and transition matrix together, then one measured quantity after the other.  For a recording without interruption. */
#include <math.h>
#include <string.h>
#define N 7
#define M 6
enum { PX, PY, THETA, VF, BF, BR, DELTA };
typedef double Matrix[N][N];
typedef struct { double l_f, l_r, T_s, d; } Chassis;
typedef struct { double x[N]; Matrix P, Phi; } Moments;

static double within(double x, double low, double high) { return x < low ? low : x > high ? high : x; }

static void twist(const double *x, const Chassis *c, double *t, double J[3][3]) {
  double sf = sin(x[BF]), cf = cos(x[BF]), tr = tan(x[BR]), L = c->l_f + c->l_r, v = x[VF], g = 1 + tr * tr;
  t[0] = cf * v, t[1] = (c->l_r * sf + c->l_f * cf * tr) / L * v, t[2] = (sf - cf * tr) / L * v;
  J[0][0] = cf, J[0][1] = -sf * v, J[0][2] = 0;
  J[1][0] = (c->l_r * sf + c->l_f * cf * tr) / L, J[1][1] = (c->l_r * cf - c->l_f * sf * tr) / L * v;
  J[1][2] = c->l_f * cf * g / L * v;
  J[2][0] = (sf - cf * tr) / L, J[2][1] = (cf + sf * tr) / L * v, J[2][2] = -cf * g / L * v;
}

static void rates(const Moments *at, double u_s, const Chassis *c, Matrix Q, Moments *k) {
  const double *x = at->x;
  double t[3], J[3][3], s = sin(x[THETA]), o = cos(x[THETA]);
  double rest = 1 - 0.5 * (tanh(10 * x[VF] - 1) + 1), pull = 20 * rest, d_pull = -400 * rest * (1 - rest);
  Matrix F = {{0}}, FP = {{0}};
  twist(x, c, t, J);
  double f[N] = {o * t[0] - s * t[1], s * t[0] + o * t[1], t[2], 0, pull * (x[DELTA] - x[BF]), -pull * x[BR],
                 within((u_s - x[DELTA]) / c->T_s, -c->d, c->d)};
  F[PX][THETA] = -f[PY], F[PY][THETA] = f[PX];
  for (int j = 0; j < 3; j++) {
    F[PX][VF + j] = o * J[0][j] - s * J[1][j], F[PY][VF + j] = s * J[0][j] + o * J[1][j], F[THETA][VF + j] = J[2][j];
  }
  F[BF][VF] = d_pull * (x[DELTA] - x[BF]), F[BF][BF] = -pull, F[BF][DELTA] = pull;
  F[BR][VF] = -d_pull * x[BR], F[BR][BR] = -pull;
  F[DELTA][DELTA] = fabs(u_s - x[DELTA]) < c->d * c->T_s ? -1 / c->T_s : 0;
  memcpy(k->x, f, sizeof f);
  memset(k->Phi, 0, sizeof k->Phi);
  for (int i = 0; i < N; i++)
    for (int m = 0; m < N; m++)
      for (int j = 0; j < N; j++) FP[i][j] += F[i][m] * at->P[m][j], k->Phi[i][j] += F[i][m] * at->Phi[m][j];
  for (int i = 0; i < N; i++)
    for (int j = 0; j < N; j++) k->P[i][j] = FP[i][j] + FP[j][i] + Q[i][j];
}

static void add(const Moments *a, double h, const Moments *k, Moments *to) {
  const double *x = (const double *)a, *rate = (const double *)k;
  double *y = (double *)to;
  for (unsigned i = 0; i < sizeof *a / sizeof(double); i++) y[i] = x[i] + h * rate[i];
}

static void predict(Moments *m, double u_s, const Chassis *c, Matrix Q, double dt, double longest) {
  int steps = (int)ceil(dt / longest - 1e-9);
  steps = steps < 1 ? 1 : steps;
  double h = dt / steps;
  memset(m->Phi, 0, sizeof m->Phi);
  for (int i = 0; i < N; i++) m->Phi[i][i] = 1;
  for (int n = 0; n < steps; n++) {
    Moments a, b, e, d, at;
    rates(m, u_s, c, Q, &a), add(m, h / 2, &a, &at);
    rates(&at, u_s, c, Q, &b), add(m, h / 2, &b, &at);
    rates(&at, u_s, c, Q, &e), add(m, h, &e, &at);
    rates(&at, u_s, c, Q, &d);
    add(m, h / 6, &a, m), add(m, h / 3, &b, m), add(m, h / 3, &e, m), add(m, h / 6, &d, m);
  }
}

static void update(Moments *m, const double *z, const int *known, const double *R, const Chassis *c) {
  static const int place[4] = {PX, PY, THETA, DELTA};
  double t[3], J[3][3], shift[N] = {0}, C[M][N] = {{0}}, h[M];
  twist(m->x, c, t, J);
  for (int i = 0; i < 4; i++) C[i][place[i]] = 1, h[i] = m->x[place[i]];
  for (int j = 0; j < 3; j++) C[4][VF + j] = J[2][j];
  h[4] = t[2];
  for (int i = 0; i < M - 1; i++) {
    if (!known[i]) continue;
    double PC[N], S = R[i], r = z[i] - h[i];
    if (i == 2) r = remainder(r, 2 * M_PI);
    for (int j = 0; j < N; j++) {
      PC[j] = 0;
      for (int k = 0; k < N; k++) PC[j] += m->P[j][k] * C[i][k];
    }
    for (int j = 0; j < N; j++) r -= C[i][j] * shift[j], S += C[i][j] * PC[j];
    for (int j = 0; j < N; j++) {
      shift[j] += PC[j] / S * r;
      for (int k = 0; k < N; k++) m->P[j][k] -= PC[j] / S * PC[k];
    }
  }
  for (int j = 0; j < N; j++) m->x[j] += shift[j];
}

/* States (K, 7) after the update of each of K events: time (s), command and measurements (K, 6) with those known. */
void filter(const double *time, const double *u_s, const double *z, const int *known, const double *x_0,
            const double *P_0, const double *chassis, const double *Q, const double *R, double longest, long K,
            double *x, double *P, double *x_prior, double *P_prior, double *Phi) {
  Chassis c = {chassis[0], chassis[1], chassis[2], chassis[3]};
  Matrix noise;
  Moments m = {{0}};
  memcpy(noise, Q, sizeof noise);
  memcpy(m.x, x_0, sizeof m.x);
  for (int i = 0; i < N; i++) m.P[i][i] = P_0[i], m.Phi[i][i] = 1;
  for (long k = 0; k < K; k++) {
    if (k > 0) predict(&m, u_s[k - 1], &c, noise, time[k] - time[k - 1], longest);
    memcpy(x_prior + N * k, m.x, sizeof m.x), memcpy(P_prior + N * N * k, m.P, sizeof m.P);
    memcpy(Phi + N * N * k, m.Phi, sizeof m.Phi);
    update(&m, z + M * k, known + M * k, R, &c);
    memcpy(x + N * k, m.x, sizeof m.x), memcpy(P + N * N * k, m.P, sizeof m.P);
  }
}
