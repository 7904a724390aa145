/* How much stack the planner's calls take, bytes: run in a thread whose stack is painted. usage: plan_stack SIZE */

#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define main tested_main
#include TESTED /* the planner's own test program, with its recorded updates */
#undef main

enum { PAINT = 0x5a };

static void *updates(void *unused) {
  const unit_preview preview = unit_own_preview_of();
  unit_command command;
  (void)unused;
  unit_plan_reset(&unit_own_plan);
  for (int i = 0; i < UNIT_OWN_UPDATES; ++i) {
    unit_plan_update(&unit_own_plan, UNIT_OWN_RECORDED[i].t, 0, &preview, &command);
    unit_plan_command_at(&unit_own_plan, UNIT_OWN_RECORDED[i].t + 0.01, &command);
  }
  return 0;
}

int main(int count, char **words) {
  size_t size = count == 2 ? (size_t)atol(words[1]) : 1 << 20, free_bytes = 0;
  unsigned char *stack = 0;
  pthread_attr_t attributes;
  pthread_t thread;
  size = (size + 4095) / 4096 * 4096;
  if (posix_memalign((void **)&stack, 4096, size)) return 2;
  memset(stack, PAINT, size);
  pthread_attr_init(&attributes);
  if (pthread_attr_setstack(&attributes, stack, size)) return 3;
  if (pthread_create(&thread, &attributes, updates, 0)) return 4;
  pthread_join(thread, 0);
  while (free_bytes < size && stack[free_bytes] == PAINT) ++free_bytes;
  printf("%zu\n", size - free_bytes);
  return 0;
}
