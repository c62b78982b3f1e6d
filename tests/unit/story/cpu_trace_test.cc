// SPDX-License-Identifier: Apache-2.0
#include "story/cpu_trace.h"

#include <map>
#include <string>

#include <gtest/gtest.h>
#include <uapi/xauto/bpf.h>

#include "story/perfetto.pb.h"
#include "story/trace_reader.h"

#include "tiny_run.h"

namespace xauto::story {
namespace {

CpuStep step(std::int64_t us, std::uint16_t kind, std::uint16_t cpu, std::uint32_t tid,
             const std::string& xnode, std::int64_t delta_us = 0, const std::string& by = {}) {
  return {us * 1000, kind, cpu, tid, xnode, xnode == "-" ? -1 : 7, delta_us * 1000, by};
}

/// "track: name begin-end args", a line each.
std::string seen(const std::string& bytes) {
  perfetto::Trace trace;
  EXPECT_TRUE(trace.ParseFromString(bytes));
  std::map<std::uint64_t, std::string> tracks, open;
  std::string out;
  for (const auto& packet : trace.packet()) {
    EXPECT_EQ(packet.trusted_packet_sequence_id(), 2u);
    if (packet.has_track_descriptor()) {
      tracks[packet.track_descriptor().uuid()] = packet.track_descriptor().name();
      continue;
    }
    const auto& event = packet.track_event();
    const std::string at = std::to_string(packet.timestamp() / 1000);
    if (event.type() == perfetto::TrackEvent::TYPE_SLICE_END) {
      out += open[event.track_uuid()].replace(open[event.track_uuid()].find('@'), 1, at) + "\n";
      continue;
    }
    std::string line = tracks.at(event.track_uuid()) + ": " + event.name() + " " + at + "-@";
    for (const auto& arg : event.debug_annotations())
      line += " " + arg.name() + "=" +
              (arg.has_string_value() ? arg.string_value() : std::to_string(arg.int_value()));
    if (event.type() == perfetto::TrackEvent::TYPE_SLICE_BEGIN)
      open[event.track_uuid()] = line;
    else
      out += line + "\n";
  }
  return out;
}

TEST(CpuTrace, AThreadIsOnItsCpuFromRunToSleepOrPreempt) {
  EXPECT_EQ(
      seen(cpu_trace(
          "t",
          {step(10, XAUTO_BPF_EV_WAKEUP, 0, 5, "a", 0, "waker"),
           step(12, XAUTO_BPF_EV_RUN, 0, 5, "a", 2), step(15, XAUTO_BPF_EV_RUN, 1, 6, "-", 0),
           step(20, XAUTO_BPF_EV_PREEMPT, 0, 5, "a", 8, "urgent"),
           step(20, XAUTO_BPF_EV_RUN, 0, 7, "b", 1), step(30, XAUTO_BPF_EV_SLEEP, 0, 7, "b", 10),
           step(31, XAUTO_BPF_EV_RUN, 0, 5, "a", 11)},
          0, 0)),
      "kernel cpu0: a 12-20 release=7 tid=5 waited_us=2 woken_by=waker preempted_by=urgent\n"
      "kernel cpu0: b 20-30 release=7 tid=7 waited_us=1\n"
      "kernel cpu0: a 31-31 release=7 tid=5 waited_us=11\n"
      "kernel cpu1: thread 6 15-31 tid=6 waited_us=0\n");
}

TEST(CpuTrace, WhatWasLostIsSaidAndDoesNotMixThreadsUp) {
  EXPECT_EQ(
      seen(cpu_trace("t",
                     {step(1, XAUTO_BPF_EV_SLEEP, 0, 5, "a"), step(2, XAUTO_BPF_EV_RUN, 0, 6, "b"),
                      step(4, XAUTO_BPF_EV_SLEEP, 0, 5, "a"), step(5, XAUTO_BPF_EV_RUN, 0, 7, "c"),
                      step(9, XAUTO_BPF_EV_SLEEP, 0, 7, "c")},
                     3, 0)),
      "t: INCOMPLETE: 3 events were lost 1-@\n"
      "kernel cpu0: b 2-5 release=7 tid=6 waited_us=0\n"
      "kernel cpu0: c 5-9 release=7 tid=7 waited_us=0\n");
  EXPECT_EQ(seen(cpu_trace("t", {}, 0, 0)), "");
}

TEST(CpuTrace, BehindARunsFileItIsOneTraceThatTheReportStillReads) {
  test::Tiny tiny;
  tiny.release(0, 0);
  const std::string cpus = cpu_trace(
      "kernel",
      {step(1, XAUTO_BPF_EV_RUN, 0, 5, "cam.pre"), step(900, XAUTO_BPF_EV_SLEEP, 0, 5, "cam.pre")},
      0, 0);
  const auto alone = read_trace(tiny.file(), "t");
  const auto both = read_trace(tiny.file() + cpus, "t");
  ASSERT_TRUE(both) << both.error().to_string();
  EXPECT_EQ(both->title, alone->title);
  EXPECT_EQ(both->rows, alone->rows);
  EXPECT_EQ(both->run.size(), alone->run.size());
  EXPECT_EQ(both->end_ns, alone->end_ns);
  EXPECT_FALSE(read_trace(cpus, "t"));  // no run in it
}

}  // namespace
}  // namespace xauto::story
