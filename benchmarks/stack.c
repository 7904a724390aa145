/* Stack that the functions of generated C use, beside its own test program: their samples are taken. For each function
   a line "name bytes". A thread runs it on memory that was filled with a pattern: what is no longer that was used,
   less what a thread uses that calls sin() alone; in the second of two runs, when the loader has bound math.h. With a
   number: all functions once, in threads with a stack of so many bytes and a page behind it that must not be touched.

       cc -DROBOT=leg -DROBOT_TEST='"test_leg.c"' -Ifolder stack.c folder/leg.c -lm -lpthread */

#define _GNU_SOURCE
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#undef _POSIX_C_SOURCE /* the test program asks for its own */
#define main its_own_main
#include ROBOT_TEST
#undef main

#define JOINED(a, b, c) a##b##c
#define NAMED(prefix, name) JOINED(prefix, _, name)
#define NAME(name) NAMED(ROBOT, name)

enum { RECORDS = sizeof RECORDED / sizeof RECORDED[0], TAKEN = RECORDS < 20 ? RECORDS : 20 };
static NAME(state) state;
static volatile double angle = 1.0;

static void *run_nothing(void *unused) {
  angle = sin(angle) + cos(angle) + atan2(angle, 0.5);
  return unused;
}

static void *run_go_to(void *unused) {
  NAME(reset)(&state);
  for (int k = 0; k < TAKEN; ++k) NAME(go_to)(&state, RECORDED[k].motion.x);
  return unused;
}

static void *run_inverse_dynamics(void *unused) {
  static NAME(efforts) efforts;
  for (int k = TAKEN; k-- > 0;) {
    NAME(inverse_dynamics)(&state, &RECORDED[k].motion, &efforts);
  }
  return unused;
}

static void *run_at(void *unused) {
  static NAME(jacobians) jacobians;
  static NAME(margins) margins;
  NAME(jacobians_at)(&state, &jacobians);
  NAME(margins_at)(&state, &margins);
  return unused;
}

#ifdef FORWARD
static void *run_forward_kinematics(void *unused) {
  static NAME(platform) platform;
  static NAME(drives) drives;
  for (int k = TAKEN; k-- > 0;) {
    memcpy(drives.position, RECORDED[k].position, sizeof drives.position);
    memcpy(drives.velocity, RECORDED[k].velocity, sizeof drives.velocity);
    NAME(forward_kinematics)(&state, &drives, &platform);
  }
  return unused;
}
#endif

/* Runs a function on a stack of so many bytes, a page in front of it that must not be touched; returns how many it used. */
static size_t used(void *(*function)(void *), size_t size) {
  const size_t page = (size_t)sysconf(_SC_PAGESIZE), room = page * (2 + size / page);
  char *memory = mmap(0, room, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0), *end = memory + room;
  pthread_attr_t attributes;
  pthread_t thread;
  if (memory == MAP_FAILED || mprotect(memory, page, PROT_NONE)) exit(3);
  memset(memory + page, 0x5a, room - page);
  /* the stack begins right behind the page, however long it is */
  if (pthread_attr_init(&attributes) || pthread_attr_setstack(&attributes, memory + page, size) ||
      pthread_create(&thread, &attributes, function, 0) || pthread_join(thread, 0))
    exit(4);
  const char *first = memory + page;
  while (first < end && *first == 0x5a) ++first;
  size_t result = (size_t)(memory + page + size - first);
  munmap(memory, room);
  return result;
}

int main(int count, char **words) {
  static const struct {
    const char *name;
    void *(*function)(void *);
  } FUNCTIONS[] = {
    {"go_to", run_go_to},
    {"inverse_dynamics", run_inverse_dynamics},
    {"at", run_at},
#ifdef FORWARD
    {"forward_kinematics", run_forward_kinematics},
#endif
  };
  const size_t plenty = (size_t)1 << 23, size = count > 1 ? (size_t)strtoul(words[1], 0, 10) : plenty;
  for (size_t i = 0; i < sizeof FUNCTIONS / sizeof FUNCTIONS[0] && count == 1; ++i) used(FUNCTIONS[i].function, plenty);
  const size_t nothing = count > 1 ? 0 : used(run_nothing, plenty) ? used(run_nothing, plenty) : 0;
  for (size_t i = 0; i < sizeof FUNCTIONS / sizeof FUNCTIONS[0]; ++i)
    printf("%s %zu\n", FUNCTIONS[i].name, used(FUNCTIONS[i].function, size) - nothing);
  return 0;
}
