// SPDX-License-Identifier: Apache-2.0
// Exports of Nsight Systems, written here after NVIDIA's documentation of them (nsight.h cites it).
#include "import/nsight.h"

#include <algorithm>
#include <array>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <random>

#include <gtest/gtest.h>
#include <sqlite3.h>
#include <unistd.h>

#include "base/index.h"
#include "model/json.h"

namespace xauto::import {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kProcess = 0x11000000000000 | (4711LL << 24);
constexpr std::int64_t kThread = kProcess | 7, kOther = kProcess | 8;
constexpr std::int64_t kUs = 1000, kMs = 1'000'000;

const char* const kDocumented[] = {
    "CREATE TABLE StringIds (id INTEGER PRIMARY KEY, value TEXT NOT NULL)",
    "CREATE TABLE NVTX_EVENTS (start INT NOT NULL, end INT, eventType INT NOT NULL, rangeId INT, "
    "category INT, color INT, "
    "text TEXT, globalTid INT, endGlobalTid INT, textId INT, domainId INT, uint64Value INT, "
    "int64Value INT, doubleValue "
    "REAL, uint32Value INT, int32Value INT, floatValue REAL)",
    "CREATE TABLE CUPTI_ACTIVITY_KIND_RUNTIME (start INT NOT NULL, end INT NOT NULL, eventClass "
    "INT NOT NULL, globalTid "
    "INT, correlationId INT, nameId INT NOT NULL, returnValue INT NOT NULL, callchainId INT)",
    "CREATE TABLE CUPTI_ACTIVITY_KIND_KERNEL (start INT NOT NULL, end INT NOT NULL, deviceId INT "
    "NOT NULL, contextId INT "
    "NOT NULL, streamId INT NOT NULL, correlationId INT, globalPid INT, demangledName INT NOT "
    "NULL, shortName INT NOT "
    "NULL)",
    "CREATE TABLE CUPTI_ACTIVITY_KIND_MEMCPY (start INT NOT NULL, end INT NOT NULL, deviceId INT "
    "NOT NULL, contextId INT "
    "NOT NULL, streamId INT NOT NULL, correlationId INT, globalPid INT, bytes INT NOT NULL, "
    "copyKind INT NOT NULL)",
    "CREATE TABLE CUPTI_ACTIVITY_KIND_MEMSET (start INT NOT NULL, end INT NOT NULL, deviceId INT "
    "NOT NULL, contextId INT "
    "NOT NULL, streamId INT NOT NULL, correlationId INT, globalPid INT, value INT NOT NULL, bytes "
    "INT NOT NULL)"};

/// An export in a file of its own.
class Export {
 public:
  explicit Export(bool tables = true) {
    static int number = 0;
    path_ = (fs::temp_directory_path() /
             ("xauto-nsight-" + std::to_string(getpid()) + "-" + std::to_string(number++)))
                .string();
    sqlite3_open(path_.c_str(), &database_);
    sql("PRAGMA synchronous=OFF; BEGIN");
    if (!tables) return;
    for (const char* table : kDocumented) sql(table);
    sql("INSERT INTO StringIds VALUES (1, 'cudaLaunchKernel_v7000'), (2, "
        "'cudaStreamSynchronize_v3020'), (3, 'track'), (4, 'cudaMemcpyAsync_v3020')");
  }
  ~Export() {
    sqlite3_close(database_);
    fs::remove(path_);
  }
  Export(const Export&) = delete;
  Export& operator=(const Export&) = delete;

  void sql(const std::string& text) {
    char* why = nullptr;
    EXPECT_EQ(sqlite3_exec(database_, text.c_str(), nullptr, nullptr, &why), SQLITE_OK) << why;
    sqlite3_free(why);
  }
  void range(const std::string& name, std::int64_t start, std::int64_t end,
             std::int64_t thread = kThread) {
    sql("INSERT INTO NVTX_EVENTS (start, end, eventType, text, globalTid) VALUES (" +
        std::to_string(start) + "," + (end < 0 ? "NULL" : std::to_string(end)) + ",59,'" + name +
        "'," + std::to_string(thread) + ")");
  }
  std::int64_t call(std::int64_t start, std::int64_t end, int name, std::int64_t thread = kThread) {
    ++correlation_;
    sql("INSERT INTO CUPTI_ACTIVITY_KIND_RUNTIME VALUES (" + std::to_string(start) + "," +
        std::to_string(end) + ",0," + std::to_string(thread) + "," + std::to_string(correlation_) +
        "," + std::to_string(name) + ",0,NULL)");
    return correlation_;
  }
  /// A kernel that is launched at `at`.
  void kernel(std::int64_t at, std::int64_t start, std::int64_t end,
              std::int64_t thread = kThread) {
    const std::int64_t correlation = call(at, at + 5 * kUs, 1, thread);
    sql("INSERT INTO CUPTI_ACTIVITY_KIND_KERNEL VALUES (" + std::to_string(start) + "," +
        std::to_string(end) + ",0,1,7," + std::to_string(correlation) + "," +
        std::to_string(kProcess) + ",0,0)");
  }
  const std::string& close() {
    if (database_ != nullptr) sql("COMMIT");
    sqlite3_close(database_);
    database_ = nullptr;
    return path_;
  }

 private:
  std::string path_;
  sqlite3* database_ = nullptr;
  std::int64_t correlation_ = 100;
};

struct Imported {
  ImportedApp app;
  std::vector<std::string> lines;
  [[nodiscard]] bool says(const std::string& words) const {
    const auto has = [&](const std::string& line) { return line.find(words) != std::string::npos; };
    return std::ranges::any_of(lines, has) ||
           std::ranges::any_of(app.todo, [&](const Todo& t) { return has(t.what); });
  }
  [[nodiscard]] const XNodeSpec& xnode(const char* name) const {
    const int x = app.app.find(name);
    EXPECT_GE(x, 0) << name;
    return app.app.xnodes[at(std::max(0, x))];
  }
};

Imported import(Export& file) {
  Imported made;
  const auto trace = read_nsight(file.close());
  EXPECT_TRUE(trace) << trace.error().to_string();
  if (!trace) return made;
  auto app = nsight_app(*trace, {"app", "an export", 0}, made.lines);
  EXPECT_TRUE(app) << app.error().to_string();
  if (!app) return made;
  const auto again = parse_imported(to_json(*app), "again");
  EXPECT_TRUE(again && to_json(*again) == to_json(*app));
  made.app = std::move(*app);
  return made;
}

TEST(Nsight, KernelsAndCopiesUnderARangeAreItsGpuTime) {
  Export file;
  for (int k = 0; k < 10; ++k) {
    const std::int64_t t = k * 20 * kMs;
    file.range("detect", t, t + 2 * kMs);
    file.kernel(t + 100 * kUs, t + kMs, t + 5 * kMs);  // ends behind the range
    const std::int64_t copy = file.call(t + 200 * kUs, t + 210 * kUs, 4);
    file.sql("INSERT INTO CUPTI_ACTIVITY_KIND_MEMCPY VALUES (" + std::to_string(t + 5 * kMs) + "," +
             std::to_string(t + 5 * kMs + 300 * kUs) + ",0,1,7," + std::to_string(copy) + "," +
             std::to_string(kProcess) + ",4096,2)");
    file.range("plan", t + 7 * kMs, t + 8 * kMs, kOther);
  }
  const Imported made = import(file);
  ASSERT_EQ(made.app.app.xnodes.size(), 2u);
  EXPECT_EQ(made.xnode("detect").wcet_us, (decltype(XNodeSpec::wcet_us){{"gpu", 5300}}));
  EXPECT_EQ(made.xnode("plan").wcet_us, (decltype(XNodeSpec::wcet_us){{"cpu", 1000}}));
  ASSERT_EQ(made.app.app.sources.size(), 2u);
  EXPECT_EQ(made.app.app.sources[0].period, *Period::of_rate("50"));
  EXPECT_TRUE(made.says("which range fires which"));
  EXPECT_TRUE(made.says("kept the gpu busy for 81 % of it"));
}

TEST(Nsight, RangesInsideAreItsStagesAndNamesComeFromStringIds) {
  Export file;
  for (int k = 0; k < 4; ++k) {
    const std::int64_t t = k * 50 * kMs;
    file.range("frame " + std::to_string(k), t, t + 40 * kMs);
    file.range("detect", t + kMs, t + 10 * kMs);
    file.range("conv", t + 2 * kMs, t + 3 * kMs);
    file.kernel(t + 2 * kMs, t + 3 * kMs, t + 9 * kMs);
    file.sql(
        "INSERT INTO NVTX_EVENTS (start, end, eventType, textId, domainId, globalTid) VALUES (" +
        std::to_string(t + 12 * kMs) + "," + std::to_string(t + 30 * kMs) + ",60,3,2," +
        std::to_string(kThread) + ")");
  }
  file.sql(
      "INSERT INTO NVTX_EVENTS (start, eventType, text, domainId, globalTid) VALUES "
      "(0,75,'Nets',2," +
      std::to_string(kThread) + ")");
  const Imported made = import(file);
  ASSERT_EQ(made.app.app.xnodes.size(), 2u);
  // What is between stages belongs to the next, and what is behind the last to that.
  EXPECT_EQ(made.xnode("frame #.detect").wcet_us.at("gpu"), 10'000);
  EXPECT_EQ(made.xnode("frame #.Nets:track").wcet_us.at("cpu"), 30'000);
  EXPECT_EQ(made.app.app.edges, (std::vector<std::pair<int, int>>{{0, 1}}));
  EXPECT_TRUE(made.says("4 ranges that are further inside"));
}

TEST(Nsight, RangesThatAThreadRunsInTurnAreEdges) {
  Export file;
  file.range("load", 0, 5 * kMs);  // once, around what is run in turn: looked through
  for (int k = 0; k < 5; ++k)
    for (const char* name : {"a", "b", "c"}) {
      const std::int64_t t = (10 + k * 30) * kMs + (name[0] - 'a') * 3 * kMs;
      file.range(name, t, t + 2 * kMs);
    }
  const Imported made = import(file);
  EXPECT_EQ(made.app.app.sources.size(), 1u);
  EXPECT_EQ(made.app.app.edges, (std::vector<std::pair<int, int>>{{0, 1}, {1, 2}}));
  EXPECT_EQ(made.app.app.chains.size(), 1u);
  EXPECT_TRUE(made.says("1 range that came fewer than three times"));
  EXPECT_TRUE(made.says("'b' comes behind 'a'"));
}

TEST(Nsight, DlaTasksAreDlaTime) {
  Export file;
  file.sql(
      "CREATE TABLE CUDLA_TASKS (start INT NOT NULL, end INT NOT NULL, globalTid INT, "
      "correlationId INT)");
  for (int k = 0; k < 5; ++k) {
    const std::int64_t t = k * 40 * kMs;
    file.range("segment", t, t + kMs);
    const std::int64_t submit = file.call(t + 10 * kUs, t + 20 * kUs, 1);
    file.sql("INSERT INTO CUDLA_TASKS VALUES (" + std::to_string(t + kMs) + "," +
             std::to_string(t + 9 * kMs) + "," + std::to_string(kThread) + "," +
             std::to_string(submit) + ")");
  }
  const Imported made = import(file);
  EXPECT_EQ(made.xnode("segment").wcet_us, (decltype(XNodeSpec::wcet_us){{"dla", 9000}}));
}

TEST(Nsight, WhatIsWrongInAnExportIsNamedAndSurvived) {
  Export file;
  for (int k = 0; k < 5; ++k) file.range("a", k * 10 * kMs, k * 10 * kMs + kMs);
  file.range("endless", 3, -1);
  file.sql(
      "INSERT INTO NVTX_EVENTS (start, end, eventType, text, globalTid) VALUES (9, 3, 59, 'a', 1), "
      "('x', 3, 59, "
      "'a', 1), (9223372036854775807, 9223372036854775807, 59, 'a', 1), (-9223372036854775808, 1, "
      "59, 'a', 1)");
  for (int k = 0; k < 3; ++k)  // each begins in an 'a' and ends behind it
    file.range("long", k * 10 * kMs + 500 * kUs, k * 10 * kMs + 5 * kMs);
  file.sql("DROP TABLE CUPTI_ACTIVITY_KIND_MEMCPY");
  file.sql(
      "DROP TABLE CUPTI_ACTIVITY_KIND_MEMSET; CREATE TABLE CUPTI_ACTIVITY_KIND_MEMSET (start INT, "
      "value INT)");
  const Imported made = import(file);
  for (const char* words :
       {"1 range without an end", "4 rows of 13 have no times", "3 ranges that overlap another",
        "CUPTI_ACTIVITY_KIND_MEMSET has no column 'end'", "it has no kernels"})
    EXPECT_TRUE(made.says(words)) << words << "\n" << testing::PrintToString(made.lines);
}

TEST(Nsight, WhatIsNoExportIsRefused) {
  for (const char* sql : {"CREATE TABLE other (a)", "CREATE VIEW NVTX_EVENTS AS SELECT 1 AS start",
                          "CREATE TABLE NVTX_EVENTS (start INT, end INT)"}) {
    Export file(false);
    file.sql(sql);
    EXPECT_FALSE(read_nsight(file.close())) << sql;
  }
  Export few;
  few.range("a", 0, 1);
  const auto trace = read_nsight(few.close());
  ASSERT_TRUE(trace);
  std::vector<std::string> lines;
  EXPECT_FALSE(nsight_app(*trace, {"app", "f", 0}, lines));
}

TEST(Nsight, AnExportThatIsCutOrChangedIsSurvived) {
  Export file;
  for (int k = 0; k < 60; ++k) {
    const std::int64_t t = k * 10 * kMs;
    file.range("a", t, t + kMs);
    file.kernel(t, t + kMs, t + 2 * kMs);
  }
  std::ifstream in(file.close(), std::ios::binary);
  const std::string whole{std::istreambuf_iterator<char>(in), {}};
  std::mt19937 random(1);
  std::size_t read = 0, noted = 0;
  for (int n = 0; n < 400; ++n) {
    std::string bytes = whole;
    if (n % 2 == 0)
      bytes.resize(bytes.size() * static_cast<std::size_t>(n) / 400);
    else
      for (int b = 0; b < n; ++b) bytes[random() % bytes.size()] = static_cast<char>(random());
    Export other(false);
    std::ofstream(other.close(), std::ios::binary)
        .write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
    const auto trace = read_nsight(other.close());
    if (!trace) continue;
    ++read;
    std::vector<std::string> lines;
    const auto app = nsight_app(*trace, {"app", "f", 0}, lines);
    EXPECT_TRUE(!app || parse_imported(to_json(*app), "again"));
    noted += trace->notes.empty() ? 0 : 1;
  }
  EXPECT_GT(read, 20u);
  EXPECT_GT(noted, 5u) << "what was left out is named";
}

// ---- a second implementation of an XNode's time -----------------------------------------------------------------------

/// Microsecond by microsecond, from the rule in words.
std::vector<std::int64_t> by_hand(const NsightTrace& trace, const std::string& name) {
  std::vector<std::int64_t> times;
  for (const NsightRange& range : trace.ranges) {
    if (range.name != name) continue;
    std::vector<const NsightWork*> own, others;
    for (const NsightWork& work : trace.work) {
      const auto call = std::ranges::find(trace.calls, work.correlation, &NsightCall::correlation);
      const bool mine = call->thread == range.thread && call->start_ns >= range.start_ns &&
                        call->start_ns <= range.end_ns;
      (mine ? own : others).push_back(&work);
    }
    std::int64_t end = range.end_ns, counted = 0;
    for (const NsightWork* work : own) end = std::max(end, work->end_ns);
    const auto runs = [](const std::vector<const NsightWork*>& list, std::int64_t t) {
      return std::ranges::any_of(
          list, [&](const NsightWork* w) { return w->start_ns <= t && t < w->end_ns; });
    };
    for (std::int64_t t = range.start_ns; t < end; t += kUs) {
      const bool waits =
          t >= range.end_ns || std::ranges::any_of(trace.calls, [&](const NsightCall& c) {
            return c.waits && c.thread == range.thread && c.start_ns <= t && t < c.end_ns;
          });
      if (own.empty() || !waits || runs(own, t) || !runs(others, t)) ++counted;
    }
    times.push_back(counted);
  }
  return times;
}

TEST(Nsight, TimesAreAsCountedMicrosecondByMicrosecond) {
  std::mt19937 random(5);
  const auto below = [&](int n) {
    return static_cast<std::int64_t>(random() % static_cast<unsigned>(n));
  };
  std::size_t waited = 0;
  for (int world = 0; world < 200; ++world) {
    NsightTrace trace;
    std::int64_t correlation = 0;
    const std::array<std::int64_t, 2> threads = {kThread, kOther};
    for (std::size_t thread = 0; thread < 2; ++thread) {
      std::int64_t now = below(20);
      for (int k = 0; k < 4; ++k) {
        const std::int64_t begin = now + below(10), end = begin + 2 + below(30);
        trace.ranges.push_back({thread == 0 ? "a" : "b", begin * kUs, end * kUs, threads[thread]});
        for (std::int64_t n = below(3); n > 0; --n) {
          const std::int64_t at = begin + below(static_cast<int>(end - begin));
          trace.calls.push_back({at * kUs, (at + 1) * kUs, threads[thread], ++correlation, false});
          const std::int64_t start = at + below(20);
          trace.work.push_back({false, 0, start * kUs, (start + 1 + below(12)) * kUs,
                                process_of(kThread), correlation, 0});
        }
        const std::int64_t wait = begin + below(static_cast<int>(end - begin));
        trace.calls.push_back(
            {wait * kUs, (wait + below(20)) * kUs, threads[thread], ++correlation, true});
        now = end + 1;
      }
    }
    std::vector<std::string> lines;
    const auto made = nsight_app(trace, {"app", "f", 0}, lines);
    ASSERT_TRUE(made) << made.error().to_string();
    for (const char* name : {"a", "b"}) {
      const std::vector<std::int64_t> expected = by_hand(trace, name);
      EXPECT_EQ(made->seen.xnodes[at(made->app.find(name))].times_us, expected) << world << name;
      std::size_t r = 0;
      for (const NsightRange& range : trace.ranges)
        if (range.name == name && expected[r++] * kUs < range.end_ns - range.start_ns) ++waited;
    }
  }
  EXPECT_GT(waited, 50u) << "few of these waited for others: they prove nothing";
}

}  // namespace
}  // namespace xauto::import
