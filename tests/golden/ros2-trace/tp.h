// SPDX-License-Identifier: Apache-2.0
// Tracepoints with the names and fields of ros2_tracing (ros2/ros2_tracing 8.4.0, tracetools/include/tracetools/tp_call.h),
// and one that it does not have.
#undef LTTNG_UST_TRACEPOINT_PROVIDER
#define LTTNG_UST_TRACEPOINT_PROVIDER ros2
#undef LTTNG_UST_TRACEPOINT_INCLUDE
#define LTTNG_UST_TRACEPOINT_INCLUDE "./tp.h"
#if !defined(XAUTO_TEST_TP_H) || defined(LTTNG_UST_TRACEPOINT_HEADER_MULTI_READ)
#define XAUTO_TEST_TP_H
#include <lttng/tracepoint.h>
#include <stdint.h>

#define F(type, name) lttng_ust_field_integer_hex(type, name, name)
#define A LTTNG_UST_TP_ARGS
#define FIELDS LTTNG_UST_TP_FIELDS
LTTNG_UST_TRACEPOINT_EVENT(ros2, rcl_node_init,
                           A(uint64_t, node_handle, const char*, node_name, const char*, space),
                           FIELDS(F(uint64_t, node_handle)
                                      lttng_ust_field_string(node_name, node_name)
                                          lttng_ust_field_string(namespace, space)))
LTTNG_UST_TRACEPOINT_EVENT(ros2, rcl_publisher_init,
                           A(uint64_t, publisher_handle, const char*, topic_name),
                           FIELDS(F(uint64_t, publisher_handle)
                                      lttng_ust_field_string(topic_name, topic_name)))
LTTNG_UST_TRACEPOINT_EVENT(ros2, rcl_subscription_init,
                           A(uint64_t, subscription_handle, uint64_t, node_handle, const char*,
                             topic_name, uint64_t, queue_depth),
                           FIELDS(F(uint64_t, subscription_handle) F(uint64_t, node_handle)
                                      lttng_ust_field_string(topic_name, topic_name)
                                          F(uint64_t, queue_depth)))
LTTNG_UST_TRACEPOINT_EVENT(ros2, rclcpp_subscription_init,
                           A(uint64_t, subscription_handle, uint64_t, subscription),
                           FIELDS(F(uint64_t, subscription_handle) F(uint64_t, subscription)))
LTTNG_UST_TRACEPOINT_EVENT(ros2, rclcpp_subscription_callback_added,
                           A(uint64_t, subscription, uint64_t, callback),
                           FIELDS(F(uint64_t, subscription) F(uint64_t, callback)))
LTTNG_UST_TRACEPOINT_EVENT(ros2, rcl_timer_init, A(uint64_t, timer_handle, int64_t, period),
                           FIELDS(F(uint64_t, timer_handle)
                                      lttng_ust_field_integer(int64_t, period, period)))
LTTNG_UST_TRACEPOINT_EVENT(ros2, rclcpp_timer_callback_added,
                           A(uint64_t, timer_handle, uint64_t, callback),
                           FIELDS(F(uint64_t, timer_handle) F(uint64_t, callback)))
LTTNG_UST_TRACEPOINT_EVENT(ros2, rclcpp_timer_link_node,
                           A(uint64_t, timer_handle, uint64_t, node_handle),
                           FIELDS(F(uint64_t, timer_handle) F(uint64_t, node_handle)))
LTTNG_UST_TRACEPOINT_EVENT(ros2, callback_start, A(uint64_t, callback),
                           FIELDS(F(uint64_t, callback)))
LTTNG_UST_TRACEPOINT_EVENT(ros2, callback_end, A(uint64_t, callback), FIELDS(F(uint64_t, callback)))
LTTNG_UST_TRACEPOINT_EVENT(ros2, rcl_publish, A(uint64_t, publisher_handle),
                           FIELDS(F(uint64_t, publisher_handle)))
LTTNG_UST_TRACEPOINT_EVENT(ros2, rmw_publish, A(uint64_t, message, int64_t, timestamp),
                           FIELDS(F(uint64_t, message)
                                      lttng_ust_field_integer(int64_t, timestamp, timestamp)))
LTTNG_UST_TRACEPOINT_EVENT(
    ros2, rmw_take, A(uint64_t, rmw_subscription_handle, int64_t, source_timestamp, int, taken),
    FIELDS(F(uint64_t, rmw_subscription_handle)
               lttng_ust_field_integer(int64_t, source_timestamp, source_timestamp)
                   lttng_ust_field_integer(int, taken, taken)))
LTTNG_UST_TRACEPOINT_EVENT(ros2, of_tomorrow, A(uint64_t, number), FIELDS(F(uint64_t, number)))
#endif
#include <lttng/tracepoint-event.h>
