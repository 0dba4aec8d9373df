/* A haptic device in shared memory, which several processes may look at: the simulator, and whoever has loaded
 * a vendor library that is simulated. Nobody has to run for it to move: who looks, moves it on to the present.
 *
 * A free mass and inertia with friction, a hand that pushes or holds, end stops, and what the device does by
 * itself: forces that are not sent again within its watchdog's time are switched off.
 */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <math.h>
#include <pthread.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#define FIELDS(X) \
  X(x) X(y) X(z) X(vx) X(vy) X(vz) X(qx) X(qy) X(qz) X(qw) X(wx) X(wy) X(wz) \
  X(gripper) X(gripper_speed) X(buttons) \
  X(fx) X(fy) X(fz) X(tx) X(ty) X(tz) X(gripper_force) \
  X(push_x) X(push_y) X(push_z) X(squeeze) X(hand) X(hand_x) X(hand_y) X(hand_z) \
  X(force_on) X(force_off_cause) X(force_at) X(watchdog) X(is_gravity_compensated) \
  X(initialized) X(homing) X(regulated) X(opened_by) X(sets) X(strongest) X(impulse) X(now) \
  X(model) X(is_left) X(home_time) X(version) \
  X(unplugged) X(saturated) X(time_guard) X(keeps_gravity) X(open_fails) X(home_fails) X(hang) X(crash) X(broken) X(no_device)

enum field {
#define NAME(name) F_##name,
  FIELDS(NAME)
#undef NAME
  FIELD_COUNT
};

static const char *const field_names[] = {
#define NAME(name) #name,
  FIELDS(NAME)
#undef NAME
};

struct plant {
  pthread_mutex_t lock;
  double f[FIELD_COUNT];
};

static struct plant *the_plant;

#define MASS 0.25            /* kg */
#define FRICTION 0.5         /* N s/m */
#define INERTIA 0.0005       /* kg m2 */
#define TURN_FRICTION 0.005  /* N m s/rad */
#define GRIPPER_INERTIA 0.001
#define GRIPPER_FRICTION 0.02
#define REACH 0.12           /* m */
#define GRIPPER_MOST 0.6     /* rad */
#define HAND_STIFFNESS 2000.0
#define HAND_DAMPING 30.0
#define STEP 0.000125        /* s */
#define LONGEST 1.0          /* s that are made up for at most */
#define CAUSE_WATCHDOG 3

static double seconds(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void plant_map(void) {
  Dl_info self;
  char path[PATH_MAX + 16];
  if (!dladdr((void *)plant_map, &self) || !realpath(self.dli_fname, path)) abort(); /* not a link's folder */
  char *slash = strrchr(path, '/');
  strcpy(slash ? slash + 1 : path, "device.mem");
  int fd = open(path, O_RDWR | O_CREAT, 0600);
  struct stat info;
  if (fd < 0 || fstat(fd, &info)) abort();
  int is_new = info.st_size < (off_t)sizeof(struct plant);
  if (is_new && ftruncate(fd, sizeof(struct plant))) abort();
  the_plant = mmap(NULL, sizeof(struct plant), PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
  close(fd);
  if (the_plant == MAP_FAILED) abort();
  if (is_new) {
    pthread_mutexattr_t attributes;
    pthread_mutexattr_init(&attributes);
    pthread_mutexattr_setpshared(&attributes, PTHREAD_PROCESS_SHARED);
    pthread_mutexattr_setrobust(&attributes, PTHREAD_MUTEX_ROBUST);
    pthread_mutex_init(&the_plant->lock, &attributes);
    the_plant->f[F_qw] = 1.0;
    the_plant->f[F_now] = seconds();
  }
}

static double *plant_lock(void) {
  static pthread_once_t once = PTHREAD_ONCE_INIT;
  pthread_once(&once, plant_map);
  if (pthread_mutex_lock(&the_plant->lock) == EOWNERDEAD) /* who had it was killed */
    pthread_mutex_consistent(&the_plant->lock);
  return the_plant->f;
}

static void plant_unlock(void) { pthread_mutex_unlock(&the_plant->lock); }

static void turn_by(double *f, double h) {
  double x = f[F_qx], y = f[F_qy], z = f[F_qz], w = f[F_qw], n;
  double a = 0.5 * h * f[F_wx], b = 0.5 * h * f[F_wy], c = 0.5 * h * f[F_wz];
  f[F_qx] = x + a * w + b * z - c * y;
  f[F_qy] = y + b * w + c * x - a * z;
  f[F_qz] = z + c * w + a * y - b * x;
  f[F_qw] = w - a * x - b * y - c * z;
  n = sqrt(f[F_qx] * f[F_qx] + f[F_qy] * f[F_qy] + f[F_qz] * f[F_qz] + f[F_qw] * f[F_qw]);
  for (int i = F_qx; i <= F_qw; i++) f[i] /= n;
}

/* Move it on to the present, with the forces that were sent last, as long as its watchdog lets them. */
static void plant_advance(double *f) {
  double end = seconds(), t = f[F_now];
  if (end - t > LONGEST) t = end - LONGEST;
  for (; t + STEP <= end; t += STEP) {
    if (f[F_force_on] && f[F_watchdog] > 0.0 && t > f[F_force_at] + f[F_watchdog]) {
      f[F_force_on] = 0.0;
      f[F_force_off_cause] = CAUSE_WATCHDOG;
    }
    double on = f[F_force_on] && !f[F_homing] ? 1.0 : 0.0;
    f[F_impulse] += STEP * on * sqrt(f[F_fx] * f[F_fx] + f[F_fy] * f[F_fy] + f[F_fz] * f[F_fz]);
    for (int i = 0; i < 3; i++) {
      double *p = &f[F_x + i], *v = &f[F_vx + i];
      if (f[F_homing]) {
        *v = -*p / 0.05;
        *p += STEP * *v;
        continue;
      }
      double force = on * f[F_fx + i] + f[F_push_x + i] - FRICTION * *v;
      if (f[F_hand]) force += HAND_STIFFNESS * (f[F_hand_x + i] - *p) - HAND_DAMPING * *v;
      *v += STEP * force / MASS;
      *p += STEP * *v;
      if (fabs(*p) > REACH) {
        *p = copysign(REACH, *p);
        *v = 0.0;
      }
      double *w = &f[F_wx + i];
      *w += STEP * (on * f[F_tx + i] - TURN_FRICTION * *w) / INERTIA;
    }
    turn_by(f, STEP);
    double grip = on * f[F_gripper_force] - f[F_squeeze] - GRIPPER_FRICTION * f[F_gripper_speed];
    f[F_gripper_speed] += STEP * grip / GRIPPER_INERTIA;
    f[F_gripper] += STEP * f[F_gripper_speed];
    if (f[F_gripper] < 0.0 || f[F_gripper] > GRIPPER_MOST) {
      f[F_gripper] = f[F_gripper] < 0.0 ? 0.0 : GRIPPER_MOST;
      f[F_gripper_speed] = 0.0;
    }
  }
  f[F_now] = t;
}

/* Take forces that were sent: N, N m, and of the gripper. */
static void plant_push(double *f, const double *wrench) {
  plant_advance(f);
  memcpy(&f[F_fx], wrench, 7 * sizeof(double));
  f[F_force_at] = f[F_now];
  f[F_sets] += 1.0;
  double size = sqrt(wrench[0] * wrench[0] + wrench[1] * wrench[1] + wrench[2] * wrench[2]);
  if (f[F_force_on] && size > f[F_strongest]) f[F_strongest] = size;
}

/* Faults of the process that has the library: it hangs, it crashes. */
static void plant_suffer(void) {
  double *f = plant_lock();
  int crash = f[F_crash] != 0.0, hangs = f[F_hang] != 0.0;
  if (crash) f[F_crash] = 0.0;
  plant_unlock();
  if (crash) abort();
  while (hangs) {
    struct timespec pause = {0, 1000000};
    nanosleep(&pause, NULL);
    f = plant_lock();
    hangs = f[F_hang] != 0.0;
    plant_unlock();
  }
}

/* Whether the device may be opened by this process; who was killed has it no more. */
static int plant_take(double *f) {
  pid_t other = (pid_t)f[F_opened_by];
  if (other && other != getpid() && (kill(other, 0) == 0 || errno == EPERM)) return 0;
  f[F_opened_by] = (double)getpid();
  return 1;
}

/* For the simulator. */

const char *sim_name(int index) {
  return index >= 0 && index < FIELD_COUNT ? field_names[index] : NULL;
}

double sim_get(int index) {
  double *f = plant_lock();
  plant_advance(f);
  double value = f[index];
  plant_unlock();
  return value;
}

void sim_set(int index, double value) {
  double *f = plant_lock();
  plant_advance(f);
  f[index] = value;
  plant_unlock();
}
