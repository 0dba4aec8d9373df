/* Stands between OpenHaptics' scheduler and Python: the callback that runs at 1 kHz in the library's thread, and a
 * mailbox. Python is not that callback, for whoever runs there may not wait.
 *
 * Built when the device is opened. It needs no header of the vendor's: functions are looked up by name, the
 * constants are those of the HDAPI reference. Forces that are not put in the mailbox again in time are zero.
 */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <pthread.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

typedef struct {
  unsigned int code;
  int internal;
  unsigned int device;
} error_info;

#define FUNCTIONS(X) \
  X(unsigned int, hdInitDevice, (const char *)) X(void, hdDisableDevice, (unsigned int)) \
  X(void, hdMakeCurrentDevice, (unsigned int)) X(void, hdEnable, (unsigned int)) \
  X(void, hdDisable, (unsigned int)) X(unsigned char, hdIsEnabled, (unsigned int)) \
  X(void, hdStartScheduler, (void)) X(void, hdStopScheduler, (void)) \
  X(unsigned long, hdScheduleAsynchronous, (unsigned int (*)(void *), void *, unsigned short)) \
  X(void, hdUnschedule, (unsigned long)) X(void, hdBeginFrame, (unsigned int)) \
  X(void, hdEndFrame, (unsigned int)) X(void, hdGetDoublev, (unsigned int, double *)) \
  X(void, hdGetIntegerv, (unsigned int, int *)) X(const char *, hdGetString, (unsigned int)) \
  X(void, hdSetDoublev, (unsigned int, const double *)) X(error_info, hdGetError, (void)) \
  X(const char *, hdGetErrorString, (unsigned int)) X(unsigned int, hdCheckCalibration, (void)) \
  X(void, hdUpdateCalibration, (unsigned int))

#define DECLARE(returns, name, takes) static returns(*name) takes;
FUNCTIONS(DECLARE)
#undef DECLARE

enum { BUTTONS = 0x2000, VELOCITY = 0x2051, TRANSFORM = 0x2052, ANGULAR_VELOCITY = 0x2053 };
enum { MODEL = 0x2501, SERIAL = 0x2504, STYLE = 0x2555, FORCE = 0x2700, LAST_FORCE = 0x2800 };
enum { WARM_MOTORS = 0x0200 };
enum { FORCE_OUTPUT = 0x4000, HIGHEST_PRIORITY = 65535, CONTINUE = 1 };
#define INVALID 0xFFFFFFFFu

/* What Python reads; in the vendor's axes and units. */
struct mailbox {
  double time;
  double transform[16];
  double velocity[3];
  double turning[3];
  double force[3];
  int buttons;
  int calibration;
  int style;
  int forces_on;
  unsigned int error;
  unsigned long frames;
};

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static struct mailbox box;
static double wanted[3], wanted_at, timeout;
static int wants_output;
static unsigned int device = INVALID;
static unsigned long job;
static char words[512];

static double seconds(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static unsigned int servo(void *nothing) {
  static struct mailbox now; /* written here alone */
  double push[3] = {0.0, 0.0, 0.0};
  int output;
  pthread_mutex_lock(&lock);
  output = wants_output;
  if (output && seconds() - wanted_at <= timeout) memcpy(push, wanted, sizeof push);
  pthread_mutex_unlock(&lock);
  hdMakeCurrentDevice(device);
  if (output != now.forces_on) {
    if (output) hdEnable(FORCE_OUTPUT);
    else hdDisable(FORCE_OUTPUT);
  }
  hdBeginFrame(device);
  hdGetDoublev(TRANSFORM, now.transform);
  hdGetDoublev(VELOCITY, now.velocity);
  hdGetDoublev(ANGULAR_VELOCITY, now.turning);
  hdGetDoublev(LAST_FORCE, now.force);
  hdGetIntegerv(BUTTONS, &now.buttons);
  if (output) hdSetDoublev(FORCE, push);
  hdEndFrame(device);
  if (now.frames % 50 == 0) now.calibration = (int)hdCheckCalibration();
  now.forces_on = hdIsEnabled(FORCE_OUTPUT);
  now.error = hdGetError().code;
  now.time = seconds();
  now.frames++;
  pthread_mutex_lock(&lock);
  unsigned int first = box.error;
  box = now;
  if (first) box.error = first; /* until it was read */
  if (now.error && now.error != WARM_MOTORS) wants_output = 0;
  pthread_mutex_unlock(&lock);
  return CONTINUE;
}

static int failed(const char *what, const char *why) {
  snprintf(words, sizeof words, "%s: %s", what, why ? why : "no reason");
  return -1;
}

const char *shim_error(void) { return words; }

/* Load the library; -1 if it is not there, -2 if it lacks something. */
int shim_load(const char *path) {
  void *library = dlopen(path, RTLD_NOW | RTLD_GLOBAL);
  if (!library) return failed("load", dlerror());
#define FIND(returns, name, takes) \
  *(void **)&name = dlsym(library, #name); \
  if (!name) return failed("it lacks", #name) - 1;
  FUNCTIONS(FIND)
#undef FIND
  return 0;
}

int shim_open(const char *name, double force_timeout) {
  timeout = force_timeout;
  device = hdInitDevice(name[0] ? name : NULL);
  error_info error = hdGetError();
  if (device == INVALID || error.code) {
    device = INVALID;
    return failed("hdInitDevice", hdGetErrorString(error.code));
  }
  hdMakeCurrentDevice(device);
  hdDisable(FORCE_OUTPUT);
  hdGetIntegerv(STYLE, &box.style);
  job = hdScheduleAsynchronous(servo, NULL, HIGHEST_PRIORITY);
  hdStartScheduler();
  error = hdGetError();
  return error.code ? failed("hdStartScheduler", hdGetErrorString(error.code)) : 0;
}

const char *shim_model(void) { return hdGetString(MODEL); }
const char *shim_serial(void) { return hdGetString(SERIAL); }
const char *shim_words(unsigned int code) { return hdGetErrorString(code); }

void shim_read(struct mailbox *to) {
  pthread_mutex_lock(&lock);
  *to = box;
  box.error = 0;
  pthread_mutex_unlock(&lock);
}

void shim_push(double x, double y, double z) {
  pthread_mutex_lock(&lock);
  wanted[0] = x;
  wanted[1] = y;
  wanted[2] = z;
  wanted_at = seconds();
  pthread_mutex_unlock(&lock);
}

void shim_enable(int on) {
  pthread_mutex_lock(&lock);
  wants_output = on;
  pthread_mutex_unlock(&lock);
}

void shim_calibrate(int style) { hdUpdateCalibration((unsigned int)style); }

void shim_close(void) {
  if (device == INVALID) return;
  hdStopScheduler();
  hdMakeCurrentDevice(device);
  hdDisable(FORCE_OUTPUT); /* the callback may not have come to it */
  hdUnschedule(job);
  hdDisableDevice(device);
  device = INVALID;
}
