// SPDX-License-Identifier: Apache-2.0
// What the runtime's measurements share: samples and their quantiles, rows of the table, pinning.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "base/clock.h"
#include "base/rt.h"

namespace xauto::bench {

/// Nanoseconds.
class Samples {
 public:
  void reserve(std::size_t n) { ns_.reserve(n); }
  void add(std::int64_t ns) { ns_.push_back(ns); }
  [[nodiscard]] double us(double quantile) {
    if (ns_.empty()) return 0;
    std::sort(ns_.begin(), ns_.end());
    const auto at = static_cast<std::size_t>(quantile * static_cast<double>(ns_.size() - 1));
    return static_cast<double>(ns_[at]) / 1000;
  }
  [[nodiscard]] std::size_t count() const { return ns_.size(); }
  [[nodiscard]] const std::vector<std::int64_t>& ns() const { return ns_; }

 private:
  std::vector<std::int64_t> ns_;
};

/// One line per case and program: for people, and `R SECTION CASE IMPL METRIC VALUE` for programs.
struct Row {
  std::string section, name, program;
  double p50 = 0, p99 = 0, p999 = 0;
};

class Table {
 public:
  void add(const std::string& section, const std::string& name, const std::string& program,
           Samples& samples, double divide = 1) {
    rows_.push_back({section, name, program, samples.us(0.5) / divide, samples.us(0.99) / divide,
                     samples.us(0.999) / divide});
    print(rows_.back());
  }
  void add(const std::string& section, const std::string& name, const std::string& program,
           double value) {
    rows_.push_back({section, name, program, value, 0, 0});
    print(rows_.back());
  }
  [[nodiscard]] const Row* find(const std::string& name, const std::string& program) const {
    for (const Row& row : rows_)
      if (row.name == name && row.program == program) return &row;
    return nullptr;
  }
  [[nodiscard]] const std::vector<Row>& rows() const { return rows_; }

 private:
  static void print(const Row& row) {
    fmt::print("  {:<12}{:<26}{:<24}{:>10.3f}{:>10.3f}{:>10.3f}\n", row.section, row.name,
               row.program, row.p50, row.p99, row.p999);
    std::fflush(stdout);
  }
  std::vector<Row> rows_;
};

struct Options {
  std::uint64_t rounds = 2000;
  double seconds = 5;
  bool fifo = false;
  std::string only;
};

/// The cores to use: one, or two (the same one twice on a machine with one core). As they were when
/// the program started: the first call is in main, before any row pins its thread.
struct Cores {
  int first, second;
};
inline Cores cores() {
  static const std::vector<int> allowed = rt::allowed_cores();
  return {allowed.front(), allowed.size() > 1 ? allowed[1] : allowed.front()};
}

void dispatch(const Options& options, Table& table);
void decisions(const Options& options, Table& table);
void suspensions(const Options& options, Table& table);
void transfers(const Options& options, Table& table);
/// A sensor_msgs/Image over DDS, beside Cyclone's own type.
void images(const Options& options, Table& table);
void coordinators(const Options& options, Table& table);

}  // namespace xauto::bench
