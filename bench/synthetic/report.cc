// SPDX-License-Identifier: Apache-2.0
#include "bench/synthetic/report.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <set>

#include <fmt/format.h>

#include "model/json_value.h"

namespace xauto::bench {
namespace {

double ratio(std::int64_t a, std::int64_t b) {
  return static_cast<double>(a) / static_cast<double>(b);
}

const std::vector<Column>& columns() {
  static const std::vector<Column> all = {
      {"ROS2 ideal", [](const Measured& m) { return ratio(m.ros2_ideal, m.xauto); }},
      {"ROS2 slices", [](const Measured& m) { return ratio(m.ros2_slices, m.xauto); }},
      {"HEFT", [](const Measured& m) { return ratio(m.heft, m.xauto); }},
      {"no sched", [](const Measured& m) { return ratio(m.unscheduled_ideal, m.xauto); }},
      {"no sch slice", [](const Measured& m) { return ratio(m.unscheduled_slices, m.xauto); }},
      {"no assign", [](const Measured& m) { return ratio(m.unassigned, m.xauto); }},
      {"slices/bound", [](const Measured& m) { return ratio(m.ros2_slices, m.bound); }},
      {"HEFT/bound", [](const Measured& m) { return ratio(m.heft, m.bound); }}};
  return all;
}

std::vector<const Measured*> select(const std::vector<Measured>& all, const std::string& platform,
                                    int nodes) {
  std::vector<const Measured*> chosen;
  for (const Measured& m : all)
    if (m.platform == platform && (nodes == 0 || m.nodes == nodes)) chosen.push_back(&m);
  return chosen;
}

std::vector<double> values(const std::vector<const Measured*>& of,
                           const std::function<double(const Measured&)>& value) {
  std::vector<double> result;
  for (const Measured* m : of) result.push_back(value(*m));
  return result;
}

std::string row(const std::string& title, const std::vector<const Measured*>& of) {
  std::string line = fmt::format("  {:>5} {:>4}", title, of.size());
  for (const Column& c : columns()) line += fmt::format(" {:>12.3f}", mean(values(of, c.value)));
  const std::vector<double> gaps = values(of, [](const Measured& m) { return 100 * m.gap(); });
  const std::vector<double> times = values(of, [](const Measured& m) { return m.solve_s; });
  int optimal = 0;
  std::vector<double> certified;
  for (const Measured* m : of) {
    optimal += m->optimal;
    if (m->certified > 0) certified.push_back(100 * (ratio(m->certified, m->xauto) - 1));
  }
  line += fmt::format(
      " {:>7.2f} {:>7.2f} {:>7.2f} {:>4}/{:<4} {:>8} {:>7.3f} {:>7.2f}\n", mean(gaps), median(gaps),
      *std::max_element(gaps.begin(), gaps.end()), optimal, of.size(),
      certified.empty() ? "-" : fmt::format("{:.2f}", mean(certified)), median(times), mean(times));
  return line;
}

std::set<std::string> platforms(const std::vector<Measured>& all) {
  std::set<std::string> found;
  for (const Measured& m : all) found.insert(m.platform);
  return found;
}

/// The paper's figures over all groups; it has none of other platforms.
struct Paper {
  double ros2, heft;
  const char* groups;
};
std::optional<Paper> paper_of(const std::string& platform) {
  if (platform == "small") return Paper{1.59, 1.22, "1.23-1.88"};
  if (platform == "large") return Paper{1.65, 1.24, "1.23-2.01"};
  return std::nullopt;
}

std::set<int> groups(const std::vector<Measured>& all) {
  std::set<int> found;
  for (const Measured& m : all) found.insert(m.nodes);
  return found;
}

/// How far the emulated XPUs, under the coordinator's decisions, are from the simulated ones.
std::string emulation(const std::vector<const Measured*>& of) {
  std::vector<double> apart, speedup;
  for (const Measured* m : of) {
    if (m->emulated <= 0) continue;
    apart.push_back(100 * std::abs(ratio(m->emulated, m->xauto) - 1));
    speedup.push_back(ratio(m->ros2_slices, m->emulated));
  }
  if (apart.empty()) return {};
  const auto equal = std::count(apart.begin(), apart.end(), 0.0);
  return fmt::format(
      "  XAuto's policies on the emulated XPUs: {} of {} take as long as simulated, the farthest "
      "{:.2f} % longer or shorter; ROS 2 with slices / XAuto there {:.3f}\n",
      equal, apart.size(), *std::max_element(apart.begin(), apart.end()), mean(speedup));
}

struct Series {
  std::string title, colour;
  std::function<double(const Measured&)> value;
};

struct Line {
  double y;
  std::string title;
};

/// Grouped bars over N, with lines for the paper's overall figures.
std::string bars(const std::vector<Measured>& all, const std::string& platform,
                 const std::string& title, const std::string& y_title,
                 const std::vector<Series>& series, const std::vector<Line>& lines, double low) {
  constexpr double kLeft = 60, kTop = 70, kHeight = 260, kGroup = 92;
  const std::set<int> ns = groups(all);
  const double width = kLeft + kGroup * static_cast<double>(ns.size()) + 170;
  double high = low;
  for (const int n : ns)
    for (const Series& s : series)
      high = std::max(high, mean(values(select(all, platform, n), s.value)));
  for (const Line& l : lines) high = std::max(high, l.y);
  high = low + (high - low) * 1.08;
  const auto y = [&](double v) { return kTop + kHeight - (v - low) / (high - low) * kHeight; };
  std::string svg = fmt::format(
      "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{:.0f}\" height=\"400\" "
      "font-family=\"sans-serif\" "
      "font-size=\"12\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
      "<text x=\"{:.0f}\" y=\"24\" font-size=\"15\">{}</text>\n"
      "<text x=\"16\" y=\"{:.0f}\" transform=\"rotate(-90 16 {:.0f})\" "
      "text-anchor=\"middle\">{}</text>\n",
      width, kLeft, title, kTop + kHeight / 2, kTop + kHeight / 2, y_title);
  const double step = high - low > 1.5 ? 0.5 : high - low > 0.5 ? 0.2 : 0.1;
  for (double v = low; v <= high; v += step)
    svg += fmt::format(
        "<line x1=\"{0:.0f}\" x2=\"{1:.0f}\" y1=\"{2:.1f}\" y2=\"{2:.1f}\" stroke=\"#ddd\"/>"
        "<text x=\"{3:.0f}\" y=\"{4:.1f}\" text-anchor=\"end\">{5:.1f}</text>\n",
        kLeft, width - 170, y(v), kLeft - 6, y(v) + 4, v);
  double x = kLeft;
  for (const int n : ns) {
    const auto of = select(all, platform, n);
    const double bar = (kGroup - 14) / static_cast<double>(series.size());
    double at = x + 7;
    for (const Series& s : series) {
      const double v = mean(values(of, s.value));
      svg += fmt::format(
          "<rect x=\"{:.1f}\" y=\"{:.1f}\" width=\"{:.1f}\" height=\"{:.1f}\" "
          "fill=\"{}\"><title>N={} {}: "
          "{:.3f}</title></rect>\n",
          at, y(v), bar - 1, std::max(0.0, kTop + kHeight - y(v)), s.colour, n, s.title, v);
      at += bar;
    }
    svg += fmt::format("<text x=\"{:.1f}\" y=\"{:.1f}\" text-anchor=\"middle\">{}</text>\n",
                       x + kGroup / 2, kTop + kHeight + 18, n);
    x += kGroup;
  }
  svg += fmt::format(
      "<text x=\"{:.1f}\" y=\"{:.1f}\" text-anchor=\"middle\">XNodes ({} DAGs a group)</text>\n",
      kLeft + (x - kLeft) / 2, kTop + kHeight + 38, select(all, platform, *ns.begin()).size());
  for (const Line& l : lines)
    svg += fmt::format(
        "<line x1=\"{0:.0f}\" x2=\"{1:.0f}\" y1=\"{2:.1f}\" y2=\"{2:.1f}\" stroke=\"#c00\" "
        "stroke-dasharray=\"6 4\"/><text x=\"{3:.0f}\" y=\"{4:.1f}\" fill=\"#c00\">{5}</text>\n",
        kLeft, width - 170, y(l.y), width - 165, y(l.y) + 4, l.title);
  double legend = kLeft;
  for (const Series& s : series) {
    svg += fmt::format(
        "<rect x=\"{0:.0f}\" y=\"36\" width=\"12\" height=\"12\" fill=\"{1}\"/><text x=\"{2:.0f}\" "
        "y=\"47\">{3}</text>\n",
        legend, s.colour, legend + 16, s.title);
    legend += 40 + 7.0 * static_cast<double>(s.title.size());
  }
  return svg + "</svg>\n";
}

}  // namespace

double mean(const std::vector<double>& v) {
  return v.empty() ? 0 : std::accumulate(v.begin(), v.end(), 0.0) / static_cast<double>(v.size());
}

double median(std::vector<double> v) {
  if (v.empty()) return 0;
  std::sort(v.begin(), v.end());
  return (v[(v.size() - 1) / 2] + v[v.size() / 2]) / 2;
}

std::string table(const std::vector<Measured>& all) {
  std::string text;
  for (const std::string& platform : platforms(all)) {
    const auto of = select(all, platform, 0);
    text += fmt::format(
        "{}: mean of latency / XAuto's latency per DAG; gap to the proven bound in %, certified "
        "above the latency in %\n",
        platform);
    text += fmt::format("  {:>5} {:>4}", "N", "DAGs");
    for (const Column& c : columns()) text += fmt::format(" {:>12}", c.title);
    text += fmt::format(" {:>7} {:>7} {:>7} {:>9} {:>8} {:>7} {:>7}\n", "gap", "median", "max",
                        "proven", "certif.", "med s", "mean s");
    for (const int n : groups(all)) text += row(std::to_string(n), select(all, platform, n));
    text += row("all", of);
    if (const auto paper = paper_of(platform))
      text += fmt::format(
          "  paper, all groups: ROS 2 {:.2f} (per group {}), HEFT {:.2f}, without scheduling -16.1 "
          "%, without assignment -37.3 %\n",
          paper->ros2, paper->groups, paper->heft);
    text += emulation(of);
    const auto loss = [&](std::size_t column) {
      return 100 * (1 - 1 / mean(values(of, columns()[column].value)));
    };
    text += fmt::format(
        "  here, as a loss of performance (1 - 1/ratio): without scheduling -{:.1f} % (ideal "
        "sharing) / -{:.1f} % (time "
        "slices), without assignment -{:.1f} %\n\n",
        loss(3), loss(4), loss(5));
  }
  return text;
}

/// Half the width of the 95 % confidence interval of the mean, by the normal distribution.
double interval(const std::vector<double>& v) {
  if (v.size() < 2) return 0;
  const double middle = mean(v);
  double squares = 0;
  for (const double x : v) squares += (x - middle) * (x - middle);
  return 1.96 *
         std::sqrt(squares / static_cast<double>(v.size() - 1) / static_cast<double>(v.size()));
}

std::string calibration(const std::vector<Measured>& all) {
  // Prototype, 8 DAGs a group, annealing for 1 s; nothing was measured in between.
  const std::map<std::string, std::map<int, double>> known = {
      {"small", {{10, 1.24}, {20, 1.32}, {30, 1.52}, {40, 1.66}}},
      {"large", {{10, 1.26}, {20, 1.33}, {30, 1.61}, {40, 1.79}}}};
  std::string text =
      "ROS 2 (ideal sharing) / XAuto, mean and 95 % confidence interval of the mean; the "
      "calibration's\nmean of 8 DAGs; ROS 2 / proven bound, which no solver can exceed on these "
      "DAGs\n";
  for (const auto& [platform, by_size] : known) {
    if (select(all, platform, 0).empty()) continue;
    text += fmt::format("  {}\n  {:>5} {:>4} {:>18} {:>12} {:>10}\n", platform, "N", "DAGs", "here",
                        "calibration", "at most");
    for (const int n : groups(all)) {
      const auto of = select(all, platform, n);
      if (of.empty()) continue;
      const auto ours = values(of, [](const Measured& m) { return ratio(m.ros2_ideal, m.xauto); });
      const auto most = values(of, [](const Measured& m) { return ratio(m.ros2_ideal, m.bound); });
      const auto found = by_size.find(n);
      text += fmt::format("  {:>5} {:>4} {:>10.3f} ± {:.3f} {:>12} {:>10.3f}\n", n, of.size(),
                          mean(ours), interval(ours),
                          found == by_size.end() ? "-" : fmt::format("{:.2f}", found->second),
                          mean(most));
    }
  }
  return text + "\n";
}

std::string speed(const std::vector<Measured>& all) {
  std::string text =
      "proven optimal, seconds, and the first answer (ms from the JSON texts; how often no worse "
      "than HEFT)\n";
  for (const std::string& platform : platforms(all)) {
    text += fmt::format("  {}\n  {:>5} {:>9} {:>7} {:>8} {:>8} {:>9} {:>9} {:>9}\n", platform, "N",
                        "proven", "%", "median s", "mean s", "median ms", "most ms", "<= HEFT");
    std::vector<int> rows(1, 0);
    for (const int n : groups(all)) rows.push_back(n);
    std::rotate(rows.begin(), rows.begin() + 1, rows.end());
    for (const int n : rows) {
      const auto of = select(all, platform, n);
      if (of.empty()) continue;
      const auto first = values(of, [](const Measured& m) { return m.first_ms; });
      const auto seconds = values(of, [](const Measured& m) { return m.solve_s; });
      const auto count = [&](const auto& holds) {
        return std::count_if(of.begin(), of.end(), [&](const Measured* m) { return holds(*m); });
      };
      const auto proven = count([](const Measured& m) { return m.optimal; });
      const auto good = count([](const Measured& m) { return m.first > 0 && m.first <= m.heft; });
      text += fmt::format(
          "  {:>5} {:>4}/{:<4} {:>7.1f} {:>8.3f} {:>8.3f} {:>9.2f} {:>9.2f} {:>4}/{:<4}\n",
          n == 0 ? "all" : std::to_string(n), proven, of.size(),
          100 * static_cast<double>(proven) / static_cast<double>(of.size()), median(seconds),
          mean(seconds), median(first), *std::max_element(first.begin(), first.end()), good,
          of.size());
    }
  }
  return text + "\n";
}

std::optional<Measured> read_line(const std::string& line) {
  const Json j = Json::parse(line).value_or(Json());
  Measured m;
  const auto take = [&](const char* key, auto& into) {
    using T = std::remove_reference_t<decltype(into)>;
    const auto found = [&] {
      if constexpr (std::is_same_v<T, std::string>)
        return j.at(key).text();
      else if constexpr (std::is_same_v<T, bool>)
        return j.at(key).boolean();
      else if constexpr (std::is_same_v<T, double>)
        return j.at(key).number();
      else
        return j.at(key).integer();
    }();
    if (found) into = static_cast<T>(*found);
    return found.has_value();
  };
  const bool whole =
      take("platform", m.platform) && take("nodes", m.nodes) && take("seed", m.seed) &&
      take("ros2_ideal_us", m.ros2_ideal) && take("ros2_slices_us", m.ros2_slices) &&
      take("heft_us", m.heft) && take("xauto_us", m.xauto) && take("bound_us", m.bound) &&
      take("certified_us", m.certified) && take("unscheduled_ideal_us", m.unscheduled_ideal) &&
      take("unscheduled_slices_us", m.unscheduled_slices) && take("unassigned_us", m.unassigned) &&
      take("optimal", m.optimal) && take("first_us", m.first) && take("first_ms", m.first_ms) &&
      take("solve_s", m.solve_s) && take("evaluations_per_s", m.evaluations_per_s);
  (void)take("emulated_us", m.emulated);  // lines of before have none
  if (!whole || m.xauto <= 0 || m.bound <= 0) return std::nullopt;
  return m;
}

std::string json_line(const Measured& m) {
  return fmt::format(
      "{{\"platform\":\"{}\",\"nodes\":{},\"seed\":{},\"ros2_ideal_us\":{},\"ros2_slices_us\":{},"
      "\"heft_us\":{},"
      "\"xauto_us\":{},\"emulated_us\":{},\"bound_us\":{},\"certified_us\":{},\"unscheduled_ideal_"
      "us\":{},"
      "\"unscheduled_slices_us\":{},"
      "\"unassigned_us\":{},\"optimal\":{},\"first_us\":{},\"first_ms\":{:.3f},\"solve_s\":{:.4f},"
      "\"evaluations_per_s\":{:.0f}}}\n",
      m.platform, m.nodes, m.seed, m.ros2_ideal, m.ros2_slices, m.heft, m.xauto, m.emulated,
      m.bound, m.certified, m.unscheduled_ideal, m.unscheduled_slices, m.unassigned, m.optimal,
      m.first, m.first_ms, m.solve_s, m.evaluations_per_s);
}

std::string speedup_svg(const std::vector<Measured>& all, const std::string& platform) {
  std::vector<Series> series = {{"ROS 2, time slices", "#4878a8", columns()[1].value},
                                {"ROS 2, ideal sharing", "#9fbfdf", columns()[0].value},
                                {"HEFT", "#e0a040", columns()[2].value},
                                {"possible at most (bound)", "#bbbbbb", columns()[6].value}};
  const auto of = select(all, platform, 0);
  if (std::all_of(of.begin(), of.end(), [](const Measured* m) { return m->emulated > 0; }))
    series.insert(series.begin() + 1, {"the same, emulated", "#406080", [](const Measured& m) {
                                         return ratio(m.ros2_slices, m.emulated);
                                       }});
  std::vector<Line> lines;
  if (const auto paper = paper_of(platform))
    lines = {{paper->ros2, fmt::format("paper, ROS 2: {:.2f}", paper->ros2)},
             {paper->heft, fmt::format("paper, HEFT: {:.2f}", paper->heft)}};
  return bars(all, platform, "Speed-up of XAuto, " + platform, "latency / XAuto's latency", series,
              lines, 1);
}

std::string ablation_svg(const std::vector<Measured>& all, const std::string& platform) {
  return bars(all, platform, "XAuto without its parts, " + platform, "latency / XAuto's latency",
              {{"without scheduling, time slices", "#4878a8", columns()[4].value},
               {"without scheduling, ideal sharing", "#9fbfdf", columns()[3].value},
               {"without assignment", "#e0a040", columns()[5].value}},
              {{1 / (1 - 0.161), "paper: -16.1 %"}, {1 / (1 - 0.373), "paper: -37.3 %"}}, 1);
}

}  // namespace xauto::bench
