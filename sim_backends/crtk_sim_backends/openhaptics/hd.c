/* Stands for OpenHaptics' libHD, with the functions that drivers call: device, scheduler, frames, state.
 *
 * Written from the constants and declarations of the HDAPI reference, not from its code. The vendor's axes are x to
 * the right, y up, z to the user, in mm; those of the simulated device are x ahead, y left, z up, in m.
 */

#include "plant.h"
#include <stdbool.h>
#include <stdint.h>

typedef struct {
  unsigned int code;
  int internal;
  unsigned int device;
} HDErrorInfo;

enum {
  HD_INVALID_ENUM = 0x0100,
  HD_INVALID_OPERATION = 0x0102,
  HD_FORCE_ERROR = 0x0204,
  HD_DEVICE_FAULT = 0x0300,
  HD_DEVICE_ALREADY_INITIATED = 0x0301,
  HD_COMM_ERROR = 0x0302,
  HD_ILLEGAL_BEGIN = 0x0400
};
enum {
  HD_CURRENT_BUTTONS = 0x2000,
  HD_CURRENT_VELOCITY = 0x2051,
  HD_CURRENT_TRANSFORM = 0x2052,
  HD_CURRENT_ANGULAR_VELOCITY = 0x2053,
  HD_DEVICE_MODEL_TYPE = 0x2501,
  HD_DEVICE_SERIAL_NUMBER = 0x2504,
  HD_CALIBRATION_STYLE = 0x2555,
  HD_CURRENT_FORCE = 0x2700,
  HD_LAST_FORCE = 0x2800,
  HD_FORCE_OUTPUT = 0x4000,
  HD_CALIBRATION_OK = 0x5000,
  HD_CALIBRATION_NEEDS_UPDATE = 0x5001,
  HD_CALIBRATION_NEEDS_MANUAL_INPUT = 0x5002,
  HD_CALIBRATION_INKWELL = 4
};
#define HD_INVALID_HANDLE 0xFFFFFFFFu
#define MM 1000.0

typedef unsigned int (*callback_t)(void *);

static callback_t the_callback;
static void *the_data;
static pthread_t the_thread;
static volatile bool runs;
static bool is_open, in_frame;
static HDErrorInfo error_stack;

static void fail(unsigned int code) {
  if (!error_stack.code) error_stack = (HDErrorInfo){code, -1, 0};
}

HDErrorInfo hdGetError(void) {
  HDErrorInfo told = error_stack;
  error_stack = (HDErrorInfo){0, 0, 0};
  return told;
}

const char *hdGetErrorString(unsigned int code) {
  switch (code) {
    case HD_FORCE_ERROR: return "Force error";
    case HD_DEVICE_FAULT: return "Device fault";
    case HD_DEVICE_ALREADY_INITIATED: return "Device already initiated";
    case HD_COMM_ERROR: return "Communication error";
  }
  return "Unknown error";
}

unsigned int hdInitDevice(const char *name) {
  plant_suffer();
  double *f = plant_lock();
  unsigned int handle = HD_INVALID_HANDLE;
  if (f[F_no_device] || f[F_unplugged]) fail(HD_COMM_ERROR);
  else if (f[F_open_fails]) fail(HD_DEVICE_FAULT);
  else if (!plant_take(f)) fail(HD_DEVICE_ALREADY_INITIATED);
  else {
    handle = 0;
    is_open = true;
    f[F_force_on] = 0.0;
    f[F_watchdog] = 0.1;
    memset(&f[F_fx], 0, 7 * sizeof(double));
  }
  plant_unlock();
  return handle;
}

void hdDisableDevice(unsigned int handle) {
  double *f = plant_lock();
  is_open = false; /* what its forces do then is not in the reference: its watchdog ends them */
  if ((pid_t)f[F_opened_by] == getpid()) f[F_opened_by] = 0.0;
  plant_unlock();
}

void hdMakeCurrentDevice(unsigned int handle) {}
unsigned int hdGetCurrentDevice(void) { return is_open ? 0 : HD_INVALID_HANDLE; }

static void output(bool on) {
  double *f = plant_lock();
  plant_advance(f);
  f[F_force_on] = on;
  f[F_force_off_cause] = 0.0;
  f[F_force_at] = f[F_now];
  plant_unlock();
}

void hdEnable(unsigned int what) {
  if (what == HD_FORCE_OUTPUT) output(true);
}
void hdDisable(unsigned int what) {
  if (what == HD_FORCE_OUTPUT) output(false);
}
unsigned char hdIsEnabled(unsigned int what) {
  double *f = plant_lock();
  plant_advance(f);
  unsigned char on = what == HD_FORCE_OUTPUT && f[F_force_on] != 0.0;
  plant_unlock();
  return on;
}

static void *servo(void *nothing) {
  struct timespec due;
  clock_gettime(CLOCK_MONOTONIC, &due);
  while (runs) {
    plant_suffer();
    if (the_callback && !the_callback(the_data)) the_callback = NULL;
    due.tv_nsec += 1000000;
    if (due.tv_nsec >= 1000000000) {
      due.tv_nsec -= 1000000000;
      due.tv_sec++;
    }
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL);
  }
  return NULL;
}

void hdStartScheduler(void) {
  runs = true;
  pthread_create(&the_thread, NULL, servo, NULL);
}
void hdStopScheduler(void) {
  if (!runs) return;
  runs = false;
  pthread_join(the_thread, NULL);
}
unsigned long hdScheduleAsynchronous(callback_t callback, void *data, unsigned short priority) {
  the_data = data;
  the_callback = callback;
  return 1;
}
void hdUnschedule(unsigned long handle) { the_callback = NULL; }

void hdBeginFrame(unsigned int handle) {
  double *f = plant_lock();
  plant_advance(f);
  if (f[F_unplugged] || !is_open) fail(HD_COMM_ERROR);
  if (f[F_saturated]) {
    fail(HD_FORCE_ERROR);
    f[F_force_on] = 0.0;
  }
  plant_unlock();
  if (in_frame) fail(HD_ILLEGAL_BEGIN);
  in_frame = true;
}
void hdEndFrame(unsigned int handle) { in_frame = false; }

static void to_vendor(const double *ours, double *theirs, double unit) {
  theirs[0] = -ours[1] * unit;
  theirs[1] = ours[2] * unit;
  theirs[2] = -ours[0] * unit;
}

void hdGetDoublev(unsigned int what, double *to) {
  double *f = plant_lock();
  double position[3] = {f[F_broken] ? NAN : f[F_x], f[F_y], f[F_z]};
  if (what == HD_CURRENT_TRANSFORM) { /* columns one after the other */
    double a = f[F_qx], b = f[F_qy], c = f[F_qz], w = f[F_qw];
    double rows[3][3] = {
      {1 - 2 * (b * b + c * c), 2 * (a * b - c * w), 2 * (a * c + b * w)},
      {2 * (a * b + c * w), 1 - 2 * (a * a + c * c), 2 * (b * c - a * w)},
      {2 * (a * c - b * w), 2 * (b * c + a * w), 1 - 2 * (a * a + b * b)},
    };
    /* Both ends are turned, so that no turn stays none: our axis of each of theirs, and its sign. */
    static const int axis[3] = {1, 2, 0};
    static const double sign[3] = {-1.0, 1.0, -1.0};
    memset(to, 0, 16 * sizeof(double));
    for (int column = 0; column < 3; column++)
      for (int row = 0; row < 3; row++)
        to[4 * column + row] = sign[row] * sign[column] * rows[axis[row]][axis[column]];
    to_vendor(position, &to[12], MM);
    to[15] = 1.0;
  } else if (what == HD_CURRENT_VELOCITY) to_vendor(&f[F_vx], to, MM);
  else if (what == HD_CURRENT_ANGULAR_VELOCITY) to_vendor(&f[F_wx], to, 1.0);
  else if (what == HD_LAST_FORCE || what == HD_CURRENT_FORCE) {
    to_vendor(&f[F_fx], to, f[F_force_on] ? 1.0 : 0.0);
  } else fail(HD_INVALID_ENUM);
  plant_unlock();
}

void hdGetIntegerv(unsigned int what, int *to) {
  double *f = plant_lock();
  if (what == HD_CURRENT_BUTTONS) *to = (int)f[F_buttons];
  else if (what == HD_CALIBRATION_STYLE) *to = HD_CALIBRATION_INKWELL;
  else fail(HD_INVALID_ENUM);
  plant_unlock();
}

const char *hdGetString(unsigned int what) {
  return what == HD_DEVICE_MODEL_TYPE ? "Touch" : what == HD_DEVICE_SERIAL_NUMBER ? "2026" : "";
}

void hdSetDoublev(unsigned int what, const double *from) {
  if (what != HD_CURRENT_FORCE || !in_frame) {
    fail(in_frame ? HD_INVALID_ENUM : HD_INVALID_OPERATION);
    return;
  }
  double *f = plant_lock();
  double wrench[7] = {-from[2], -from[0], from[1], 0, 0, 0, 0};
  if (!f[F_unplugged]) plant_push(f, wrench);
  plant_unlock();
}

unsigned int hdCheckCalibration(void) {
  double *f = plant_lock();
  bool known = f[F_initialized] != 0.0, updates = f[F_home_fails] != 0.0;
  plant_unlock();
  if (known) return HD_CALIBRATION_OK;
  return updates ? HD_CALIBRATION_NEEDS_UPDATE : HD_CALIBRATION_NEEDS_MANUAL_INPUT;
}
void hdUpdateCalibration(unsigned int style) {}
