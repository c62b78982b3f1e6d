// SPDX-License-Identifier: Apache-2.0
// Acts as a ROS 2 program with a single-threaded executor, as far as ros2_tracing sees one: a timer of 20 ms whose
// callback takes 2 ms and publishes /tick, which fires one of 3 ms that publishes /out; and a camera outside whose
// messages come every 50 ms and take 4 ms. `flood`: then more events than a small buffer holds.
#define LTTNG_UST_TRACEPOINT_CREATE_PROBES
#define LTTNG_UST_TRACEPOINT_DEFINE
#include "tp.h"

#include <string.h>
#include <time.h>

static int64_t now(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return t.tv_sec * 1000000000LL + t.tv_nsec;
}

static void sleep_until(int64_t ns) {
  struct timespec t = {ns / 1000000000LL, ns % 1000000000LL};
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL) != 0) {
  }
}

static void run(uint64_t callback, int64_t ns, uint64_t publisher, int64_t stamp) {
  lttng_ust_tracepoint(ros2, callback_start, callback);
  sleep_until(now() + ns);
  if (publisher != 0) {
    lttng_ust_tracepoint(ros2, rcl_publish, publisher);
    lttng_ust_tracepoint(ros2, rmw_publish, 1, stamp);
  }
  lttng_ust_tracepoint(ros2, callback_end, callback);
}

int main(int argc, char** argv) {
  const int64_t kMs = 1000000;
  lttng_ust_tracepoint(ros2, rcl_node_init, 0x10, "ticker", "/");
  lttng_ust_tracepoint(ros2, rcl_node_init, 0x20, "worker", "/front");
  lttng_ust_tracepoint(ros2, rcl_publisher_init, 0x11, "/tick");
  lttng_ust_tracepoint(ros2, rcl_publisher_init, 0x21, "/out");
  lttng_ust_tracepoint(ros2, rcl_subscription_init, 0x22, 0x20, "/tick", 5);
  lttng_ust_tracepoint(ros2, rclcpp_subscription_init, 0x22, 0x23);
  lttng_ust_tracepoint(ros2, rclcpp_subscription_callback_added, 0x23, 0x24);
  lttng_ust_tracepoint(ros2, rcl_subscription_init, 0x25, 0x20, "/camera", 5);
  lttng_ust_tracepoint(ros2, rclcpp_subscription_init, 0x25, 0x26);
  lttng_ust_tracepoint(ros2, rclcpp_subscription_callback_added, 0x26, 0x27);
  lttng_ust_tracepoint(ros2, rcl_timer_init, 0x12, 20 * kMs);
  const int64_t made = now();
  lttng_ust_tracepoint(ros2, rclcpp_timer_callback_added, 0x12, 0x13);
  lttng_ust_tracepoint(ros2, rclcpp_timer_link_node, 0x12, 0x10);
  for (int k = 0; k < 40; ++k) {
    sleep_until(made + (k + 1) * 20 * kMs);
    run(0x13, 2 * kMs, 0x11, 1000 + k);
    lttng_ust_tracepoint(ros2, rmw_take, 0x22, 1000 + k, 1);
    run(0x24, 3 * kMs, 0x21, 5000 + k);
    if (k % 5 == 0 || k % 5 == 2) {  // at 0, 40, 100, 140, ...: every 50 ms, as its executor comes to it
      lttng_ust_tracepoint(ros2, rmw_take, 0x25, 9000 + k, 1);
      run(0x27, 4 * kMs, 0, 0);
    }
  }
  if (argc > 1 && strcmp(argv[1], "flood") == 0)
    for (int k = 0; k < 20000; ++k) lttng_ust_tracepoint(ros2, of_tomorrow, (uint64_t)k);
  lttng_ust_tracepoint(ros2, of_tomorrow, 1);
  return 0;
}
