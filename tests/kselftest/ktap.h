/* SPDX-License-Identifier: Apache-2.0 */
/*
 * The little that a KTAP test program needs (Documentation/dev-tools/ktap.rst), in C and C++.
 * kselftest's own header comes with the kernel's source only; what this prints has its format.
 *
 *	int main(void)
 *	{
 *		ktap_plan(2);
 *		ktap_test(a == b, "A equals B");
 *		ktap_skip("C sorts first", "no C here");
 *		return ktap_exit();
 *	}
 *
 * Not thread safe: one thread reports.
 */
#ifndef XAUTO_TESTS_KTAP_H
#define XAUTO_TESTS_KTAP_H

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

#define KTAP_PASS 0
#define KTAP_FAIL 1
#define KTAP_SKIP 4

static int ktap_planned, ktap_run, ktap_failed, ktap_skipped;

static inline void ktap_plan(int count) {
  setvbuf(stdout, NULL, _IOLBF, 0);
  ktap_planned = count;
  printf("TAP version 13\n1..%d\n", count);
}

__attribute__((format(printf, 1, 2))) static inline void ktap_note(const char* format, ...) {
  va_list args;

  va_start(args, format);
  printf("# ");
  vprintf(format, args);
  printf("\n");
  va_end(args);
}

__attribute__((format(printf, 2, 3))) static inline int ktap_test(int good, const char* format,
                                                                  ...) {
  va_list args;

  va_start(args, format);
  printf("%s %d ", good ? "ok" : "not ok", ++ktap_run);
  vprintf(format, args);
  printf("\n");
  va_end(args);
  ktap_failed += !good;
  return good;
}

static inline void ktap_skip(const char* name, const char* why) {
  printf("ok %d %s # SKIP %s\n", ++ktap_run, name, why);
  ktap_skipped++;
}

/* Ends the program where going on makes no sense; what was planned and did not run counts as
 * failed. */
__attribute__((format(printf, 1, 2), noreturn)) static inline void ktap_bail(const char* format,
                                                                             ...) {
  va_list args;

  va_start(args, format);
  printf("Bail out! ");
  vprintf(format, args);
  printf("\n");
  va_end(args);
  exit(KTAP_FAIL);
}

static inline int ktap_exit(void) {
  if (ktap_run != ktap_planned) printf("# planned %d tests, ran %d\n", ktap_planned, ktap_run);
  printf("# pass:%d fail:%d skip:%d\n", ktap_run - ktap_failed - ktap_skipped, ktap_failed,
         ktap_skipped);
  if (ktap_failed || ktap_run != ktap_planned) return KTAP_FAIL;
  return ktap_skipped == ktap_run && ktap_run ? KTAP_SKIP : KTAP_PASS;
}

#endif
