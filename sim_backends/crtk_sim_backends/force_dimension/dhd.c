/* Stands for Force Dimension's libdrd, with the functions that drivers call: DHD and DRD, SDK 3.
 *
 * There is one device, number 0; -1, the default, means it as well. The functions of not_simulated.h are there
 * to be found by programs that bind all, and fail. Written from the declarations and the constants of the SDK's documentation (DHD and DRD API), not from its
 * code. A call returns a negative number when it fails; dhdErrorGetLastStr says why.
 */

#include "plant.h"
#include <stdbool.h>
#include <stdio.h>

enum {
  DHD_ERROR_COM = 2,
  DHD_ERROR_NO_DEVICE_FOUND = 5,
  DHD_ERROR_NOT_AVAILABLE = 6,
  DHD_ERROR_TIMEOUT = 7,
  DHD_ERROR_EXPERT_MODE_DISABLED = 9,
  DHD_ERROR_DEVICE_NOT_READY = 12,
  DHD_ERROR_DEVICE_IN_USE = 20
};
enum { TIMEGUARD = 1, MOTOR_SATURATED = 2 };
enum { STATUS_FORCE = 5, STATUS_GRAVITY = 10, STATUS_FORCEOFFCAUSE = 14, MAX_STATUS = 17, FORCEOFF_SOFTWARE = 4 };

struct model {
  int type, left_type;
  const char *name;
  bool wrist, active_wrist, gripper, active_gripper;
};

/* In the order of the simulator's option. */
static const struct model models[] = {
  {33, 33, "omega.3", false, false, false, false}, {34, 36, "omega.6", true, false, false, false},
  {35, 37, "omega.7", true, false, true, true},    {63, 63, "delta.3", false, false, false, false},
  {64, 64, "delta.6", true, true, false, false},   {104, 105, "sigma.7", true, true, true, true},
  {108, 109, "lambda.7", true, true, true, true},  {60, 60, "Falcon", false, false, false, false},
};

static __thread int last_error;
static bool is_open, is_expert;

static const char *words(int error) {
  switch (error) {
    case 0: return "no error";
    case DHD_ERROR_COM: return "communication error between the host and the device";
    case DHD_ERROR_NO_DEVICE_FOUND: return "no device found";
    case DHD_ERROR_NOT_AVAILABLE: return "not simulated";
    case DHD_ERROR_TIMEOUT: return "the operation timed out";
    case DHD_ERROR_EXPERT_MODE_DISABLED: return "expert mode is disabled";
    case DHD_ERROR_DEVICE_NOT_READY: return "the device is not ready to process commands";
    case DHD_ERROR_DEVICE_IN_USE: return "the device is already in use";
  }
  return "undocumented error";
}

static int fail(int error) {
  last_error = error;
  return -1;
}

/* Lock the plant, moved on to now, of a device that answers; NULL, not locked, if it does not. */
static double *device(void) {
  plant_suffer();
  double *f = plant_lock();
  plant_advance(f);
  if (is_open && !f[F_unplugged]) return f;
  plant_unlock();
  fail(is_open ? DHD_ERROR_COM : DHD_ERROR_NO_DEVICE_FOUND);
  return NULL;
}

static int done(int result) {
  plant_unlock();
  return result;
}

static const struct model *which(void) {
  double *f = plant_lock();
  const struct model *found = &models[(int)f[F_model]];
  plant_unlock();
  return found;
}

static bool is_left(void) {
  double *f = plant_lock();
  bool left = f[F_is_left] != 0.0;
  plant_unlock();
  return left;
}

int dhdErrorGetLast(void) { return last_error; }
const char *dhdErrorGetLastStr(void) { return words(last_error); }
const char *dhdErrorGetStr(int error) { return words(error); }

void dhdGetSDKVersion(int *major, int *minor, int *release, int *revision) {
  double *f = plant_lock();
  *major = (int)f[F_version];
  plant_unlock();
  *minor = 16;
  *release = 0;
  *revision = 1;
}

int dhdEnableExpertMode(void) {
  is_expert = true;
  return 0;
}

int dhdDisableExpertMode(void) {
  is_expert = false;
  return 0;
}

int dhdGetDeviceCount(void) {
  plant_suffer();
  double *f = plant_lock();
  return done(f[F_no_device] || f[F_unplugged] ? 0 : 1);
}

/* The device itself, as all that follow: with this library there is no other. */
int drdOpenID(char id) {
  plant_suffer();
  double *f = plant_lock();
  if (id > 0 || f[F_no_device] || f[F_unplugged]) return done(fail(DHD_ERROR_NO_DEVICE_FOUND));
  if (f[F_open_fails]) return done(fail(DHD_ERROR_DEVICE_NOT_READY));
  if (!plant_take(f)) return done(fail(DHD_ERROR_DEVICE_IN_USE));
  is_open = true;
  f[F_is_gravity_compensated] = 1.0;
  memset(&f[F_fx], 0, 7 * sizeof(double));
  return done(0);
}

int dhdOpenID(char id) { return drdOpenID(id); }
int dhdOpen(void) { return drdOpenID(-1); }
int drdOpen(void) { return drdOpenID(-1); }

int dhdGetDeviceID(void) { return is_open ? 0 : fail(DHD_ERROR_NO_DEVICE_FOUND); }
int drdGetDeviceID(void) { return dhdGetDeviceID(); }

int drdClose(char id) {
  double *f = plant_lock();
  is_open = false;
  if (f[F_force_on] && !f[F_unplugged]) {
    f[F_force_on] = 0.0;
    f[F_force_off_cause] = FORCEOFF_SOFTWARE;
  }
  if ((pid_t)f[F_opened_by] == getpid()) f[F_opened_by] = 0.0;
  return done(0);
}

int dhdClose(char id) { return drdClose(id); }

const char *dhdGetSystemName(char id) { return is_open ? which()->name : NULL; }
int dhdGetSystemType(char id) {
  if (!is_open) return fail(DHD_ERROR_NO_DEVICE_FOUND);
  return is_left() ? which()->left_type : which()->type;
}
int dhdGetSerialNumber(unsigned short *number, char id) {
  *number = 2026;
  return is_open ? 0 : fail(DHD_ERROR_NO_DEVICE_FOUND);
}
bool dhdIsLeftHanded(char id) { return is_left(); }
bool dhdHasBase(char id) { return false; }
bool dhdHasWrist(char id) { return which()->wrist; }
bool dhdHasActiveWrist(char id) { return which()->active_wrist; }
bool dhdHasGripper(char id) { return which()->gripper; }
bool dhdHasActiveGripper(char id) { return which()->active_gripper; }

int dhdGetStatus(int status[MAX_STATUS], char id) {
  double *f = device();
  if (!f) return -1;
  memset(status, 0, MAX_STATUS * sizeof(int));
  status[STATUS_FORCE] = f[F_force_on] != 0.0;
  status[STATUS_GRAVITY] = f[F_is_gravity_compensated] != 0.0;
  status[STATUS_FORCEOFFCAUSE] = (int)f[F_force_off_cause];
  return done(0);
}

int dhdEnableForce(unsigned char on, char id) {
  double *f = device();
  if (!f) return -1;
  f[F_force_on] = on;
  f[F_force_off_cause] = on ? 0.0 : FORCEOFF_SOFTWARE;
  f[F_force_at] = f[F_now];
  return done(0);
}

/* Brakes hold while forces are off. */
int dhdStop(char id) { return dhdEnableForce(0, id); }

int dhdSetGravityCompensation(int on, char id) {
  double *f = device();
  if (!f) return -1;
  if (!f[F_keeps_gravity]) f[F_is_gravity_compensated] = on;
  return done(0);
}

int dhdSetWatchdog(unsigned char value, char id) {
  if (!is_expert) return fail(DHD_ERROR_EXPERT_MODE_DISABLED);
  double *f = device();
  if (!f) return -1;
  f[F_watchdog] = 0.000125 * value;
  return done(0);
}

int dhdGetWatchdog(unsigned char *value, char id) {
  if (!is_expert) return fail(DHD_ERROR_EXPERT_MODE_DISABLED);
  double *f = device();
  if (!f) return -1;
  *value = (unsigned char)lround(f[F_watchdog] / 0.000125);
  return done(0);
}

bool drdIsInitialized(char id) {
  double *f = device();
  return f ? done(f[F_initialized] != 0.0) : false;
}

bool drdIsSupported(char id) { return is_open; }

bool drdIsRunning(char id) {
  double *f = device();
  return f ? done(f[F_regulated] != 0.0) : false;
}

bool drdIsMoving(char id) {
  double *f = device();
  return f ? done(f[F_homing] != 0.0) : false;
}

/* It moves the device, and returns when that is done, or drdStop was called. */
int drdAutoInit(char id) {
  double *f = device();
  if (!f) return -1;
  double end = f[F_now] + f[F_home_time];
  f[F_homing] = f[F_regulated] = 1.0;
  f[F_initialized] = 0.0;
  plant_unlock();
  for (;;) {
    struct timespec pause = {0, 2000000};
    nanosleep(&pause, NULL);
    if (!(f = device())) return -1;
    if (!f[F_homing]) return done(fail(DHD_ERROR_TIMEOUT));
    if (f[F_now] >= end) break;
    plant_unlock();
  }
  bool failed = f[F_home_fails] != 0.0;
  f[F_homing] = 0.0;
  f[F_vx] = f[F_vy] = f[F_vz] = 0.0;
  f[F_initialized] = !failed;
  return done(failed ? fail(DHD_ERROR_TIMEOUT) : 0);
}

int drdStop(bool forces_stay, char id) {
  double *f = device();
  if (!f) return -1;
  f[F_homing] = f[F_regulated] = 0.0;
  if (!forces_stay) {
    f[F_force_on] = 0.0;
    f[F_force_off_cause] = FORCEOFF_SOFTWARE;
  }
  return done(0);
}

static void frame_of(const double *f, double m[3][3]) {
  double a = f[F_qx], b = f[F_qy], c = f[F_qz], w = f[F_qw];
  double rows[3][3] = {
    {1 - 2 * (b * b + c * c), 2 * (a * b - c * w), 2 * (a * c + b * w)},
    {2 * (a * b + c * w), 1 - 2 * (a * a + c * c), 2 * (b * c - a * w)},
    {2 * (a * c - b * w), 2 * (b * c + a * w), 1 - 2 * (a * a + b * b)},
  };
  memcpy(m, rows, sizeof rows);
}

int dhdGetOrientationFrame(double m[3][3], char id) {
  double *f = device();
  if (!f) return -1;
  frame_of(f, m);
  return done(f[F_time_guard] ? TIMEGUARD : 0);
}

int dhdGetPositionAndOrientationFrame(double *x, double *y, double *z, double m[3][3], char id) {
  double *f = device();
  if (!f) return -1;
  *x = f[F_broken] ? NAN : f[F_x];
  *y = f[F_y];
  *z = f[F_z];
  frame_of(f, m);
  return done(f[F_time_guard] ? TIMEGUARD : 0);
}

static int three(double *x, double *y, double *z, int first) {
  double *f = device();
  if (!f) return -1;
  *x = f[first];
  *y = f[first + 1];
  *z = f[first + 2];
  return done(f[F_time_guard] ? TIMEGUARD : 0);
}

int dhdGetPosition(double *x, double *y, double *z, char id) {
  double m[3][3];
  return dhdGetPositionAndOrientationFrame(x, y, z, m, id);
}
int dhdGetLinearVelocity(double *x, double *y, double *z, char id) {
  return three(x, y, z, F_vx);
}
int dhdGetAngularVelocityRad(double *x, double *y, double *z, char id) {
  return three(x, y, z, F_wx);
}

static double sign(void) { return is_left() ? -1.0 : 1.0; }

static int one(double *value, int field, double factor) {
  double *f = device();
  if (!f) return -1;
  *value = factor * f[field];
  return done(0);
}

int dhdGetGripperAngleRad(double *value, char id) { return one(value, F_gripper, sign()); }
int dhdGetGripperAngularVelocityRad(double *value, char id) {
  return one(value, F_gripper_speed, sign());
}

unsigned int dhdGetButtonMask(char id) {
  double *f = device();
  return f ? (unsigned int)done((int)f[F_buttons]) : 0;
}

int dhdGetButton(int index, char id) {
  double *f = device();
  return f ? done((int)f[F_buttons] >> index & 1) : -1;
}

int dhdGetForceAndTorqueAndGripperForce(double *fx, double *fy, double *fz, double *tx, double *ty,
                                        double *tz, double *grip, char id) {
  double left = sign();
  double *f = device();
  if (!f) return -1;
  double on = f[F_force_on];
  double *to[] = {fx, fy, fz, tx, ty, tz, grip};
  for (int i = 0; i < 7; i++) *to[i] = on * f[F_fx + i] * (i == 6 ? left : 1.0);
  return done(0);
}

int dhdSetForceAndTorqueAndGripperForce(double fx, double fy, double fz, double tx, double ty,
                                        double tz, double grip, char id) {
  double left = sign();
  double *f = device();
  if (!f) return -1;
  double wrench[7] = {fx, fy, fz, tx, ty, tz, left * grip};
  plant_push(f, wrench);
  return done(f[F_saturated] ? MOTOR_SATURATED : 0);
}

int dhdGetForceAndTorque(double *fx, double *fy, double *fz, double *tx, double *ty, double *tz, char id) {
  double grip;
  return dhdGetForceAndTorqueAndGripperForce(fx, fy, fz, tx, ty, tz, &grip, id);
}
int dhdGetForce(double *fx, double *fy, double *fz, char id) {
  double tx, ty, tz;
  return dhdGetForceAndTorque(fx, fy, fz, &tx, &ty, &tz, id);
}

int dhdSetForceAndTorque(double fx, double fy, double fz, double tx, double ty, double tz, char id) {
  return dhdSetForceAndTorqueAndGripperForce(fx, fy, fz, tx, ty, tz, 0.0, id);
}
int dhdSetForceAndGripperForce(double fx, double fy, double fz, double grip, char id) {
  return dhdSetForceAndTorqueAndGripperForce(fx, fy, fz, 0.0, 0.0, 0.0, grip, id);
}
int dhdSetForce(double fx, double fy, double fz, char id) {
  return dhdSetForceAndGripperForce(fx, fy, fz, 0.0, id);
}

double dhdGetTime(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

void dhdSleep(double seconds) {
  struct timespec pause = {(time_t)seconds, (long)(1e9 * (seconds - floor(seconds)))};
  nanosleep(&pause, NULL);
}

/* Nobody sits at a keyboard. */
bool dhdKbHit(void) { return false; }
char dhdKbGet(void) { return 0; }

static int not_simulated(void) { return fail(DHD_ERROR_NOT_AVAILABLE); }

#define CALL(name) int name(void) { return not_simulated(); }
#define NUMBER(name) double name(void) { return not_simulated(); }
#define FLAG(name) bool name(void) { return not_simulated() == 0; }
#define NOTHING(name) void name(void) { not_simulated(); }
#include "not_simulated.h"
