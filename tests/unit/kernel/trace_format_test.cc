// SPDX-License-Identifier: Apache-2.0
// The texts are those of Linux 5.15 and 6.18.
#include "kernel/trace_format.h"

#include <filesystem>
#include <fstream>
#include <string>

#include <gtest/gtest.h>
#include <unistd.h>

namespace xauto::kernel {
namespace {

const std::string kSwitch = R"(name: sched_switch
ID: 316
format:
	field:unsigned short common_type;	offset:0;	size:2;	signed:0;
	field:int common_pid;	offset:4;	size:4;	signed:1;

	field:char prev_comm[16];	offset:8;	size:16;	signed:0;
	field:pid_t prev_pid;	offset:24;	size:4;	signed:1;
	field:int prev_prio;	offset:28;	size:4;	signed:1;
	field:long prev_state;	offset:32;	size:8;	signed:1;
	field:char next_comm[16];	offset:40;	size:16;	signed:0;
	field:pid_t next_pid;	offset:56;	size:4;	signed:1;

print fmt: "prev_pid=%d next_pid=%d", REC->prev_pid, REC->next_pid
)";

TEST(TraceFormat, SaysWhereARecordHasWhat) {
  const auto pid = trace_field(kSwitch, "next_pid"), comm = trace_field(kSwitch, "next_comm");
  ASSERT_TRUE(pid && comm);
  EXPECT_EQ(pid->at, 56u);
  EXPECT_EQ(pid->size, 4u);
  EXPECT_EQ(comm->at, 40u);
  EXPECT_EQ(comm->size, 16u);
  EXPECT_EQ(trace_field("\tfield:__data_loc char[] comm;\toffset:8;\tsize:4;\tsigned:0;\n", "comm")
                .error()
                .what,
            "no such field")
      << "a string elsewhere is not a field of that name here";
}

TEST(TraceFormat, WhatIsNotThereOrInNoRecordIsRefused) {
  EXPECT_EQ(trace_field(kSwitch, "pid").error().what, "no such field") << "not a part of a name";
  EXPECT_FALSE(trace_field("", "pid"));
  for (const char* place :
       {"\toffset:0;\tsize:4;", "\toffset:7;\tsize:4;", "\toffset:8192;\tsize:4;",
        "\toffset:8190;\tsize:4;", "\toffset:24;\tsize:0;", "\toffset:24;\tsize:4294967295;",
        "\toffset:99999999999;\tsize:4;", "\toffset:-8;\tsize:4;", "\toffset:24;", "\toffset:24",
        "\tsize:4;", "\toffset:;\tsize:;", ""})
    EXPECT_EQ(trace_field("\tfield:pid_t pid;" + std::string(place) + "\n", "pid").error().what,
              "a field that is in no record")
        << place;
  EXPECT_TRUE(trace_field("\tfield:pid_t pid;\toffset:8188;\tsize:4;", "pid"));
}

TEST(TraceFormat, IsReadWhereTheKernelHasIt) {
  const std::string root =
      std::filesystem::temp_directory_path() / ("xauto-format-" + std::to_string(getpid()));
  const std::string folder = root + "/sys/kernel/tracing/events/sched/sched_switch";
  std::filesystem::create_directories(folder);
  EXPECT_NE(trace_format("sched/sched_switch", root).error().what.find("/format cannot be read"),
            std::string::npos);
  std::ofstream(folder + "/format") << kSwitch;
  EXPECT_EQ(trace_format("sched/sched_switch", root).value(), kSwitch);
  std::filesystem::remove_all(root);
}

}  // namespace
}  // namespace xauto::kernel
