// SPDX-License-Identifier: Apache-2.0
#include "xauto/windows.h"

#include <algorithm>
#include <cmath>
#include <map>

#include <fmt/format.h>

#include "base/index.h"
#include "model/components.h"
#include "story/svg.h"

namespace xauto::cli {
namespace {

using story::clipped;
using story::kColours;
using story::xml_safe;

constexpr std::size_t kMostName = 24;  // bytes of a name
constexpr int kLeft = 200, kWidth = 1100, kRight = 20, kRow = 18, kTitle = 46, kGap = 34;

constexpr const char* kStyle = R"(<style>
  :root { --fg:#1c1f24; --dim:#646b76; --line:#d5d9df; --lane:#f4f5f7; --back:#fff }
  @media (prefers-color-scheme: dark) { :root { --fg:#e7e9ed; --dim:#9aa2ae; --line:#3a404a; --lane:#22262d; --back:#14171c } }
  svg { background:var(--back) } text { fill:var(--fg) } .dim { fill:var(--dim); font-size:12px } .b { font-weight:650 } .e { text-anchor:end }
  .lane { fill:var(--lane) } .grid { stroke:var(--line) } .window { fill-opacity:.25 } .tight { stroke:#D00000; stroke-width:2 }
</style>
)";

/// 1, 2 or 5 times a power of ten microseconds, so that about ten lines are there.
double step_us(double span_us) {
  double step = 1;
  while (span_us / step > 12) {
    if (span_us / (2 * step) <= 12) return 2 * step;
    if (span_us / (5 * step) <= 12) return 5 * step;
    step *= 10;
  }
  return step;
}

class Picture {
 public:
  Picture(const AppSpec& app, const Platform& platform, const Policy& policy,
          const solver::keys::CheckReport& report)
      : app_(app),
        platform_(platform),
        policy_(policy),
        report_(report),
        found_(find_components(app).value()) {
    for (const ModuleSpec& m : app.modules)
      colour_.try_emplace(m.name, kColours[colour_.size() % std::size(kColours)]);
  }

  std::string draw() {
    text(8, 22, "b", xml_safe(app_.name + " on " + platform_.name));
    y_ = kTitle;
    for (const Domain& domain : found_.domains) panel(domain);
    rect(8, y_ + 2, 34, 10, "window", "#0072B2");
    text(48, y_ + 12, "dim", "ready by … key: its window");
    rect(238, y_ + 4, 34, 6, "", "#0072B2");
    text(278, y_ + 12, "dim", "from planned start to end, where the plan says so");
    rect(608, y_ + 2, 34, 10, "window tight", "#0072B2");
    text(648, y_ + 12, "dim", "the tightest of its XPU");
    const int height = y_ + 24;
    return fmt::format(
               "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {}\" "
               "font-family=\"system-ui, sans-serif\" font-size=\"13\" role=\"img\" "
               "aria-label=\"Windows of {}\">\n",
               kLeft + kWidth + kRight, height, xml_safe(app_.name)) +
           kStyle + out_ + "</svg>\n";
  }

 private:
  void text(int x, int y, const char* style, const std::string& safe) {
    out_ += fmt::format("<text x=\"{}\" y=\"{}\" class=\"{}\">{}</text>\n", x, y, style, safe);
  }
  void rect(double x, double y, double width, double height, const char* style,
            const std::string& colour, const std::string& title = {}) {
    out_ += fmt::format(
        "<rect x=\"{:.1f}\" y=\"{:.1f}\" width=\"{:.1f}\" height=\"{:.1f}\" class=\"{}\"", x, y,
        width, height, style);
    if (!colour.empty()) out_ += fmt::format(" fill=\"{}\"", colour);
    out_ += title.empty() ? "/>\n" : "><title>" + xml_safe(title) + "</title></rect>\n";
  }

  /// What is drawn of a domain: a hyperperiod, or a whole number of the longest periods, or less.
  [[nodiscard]] double span_us(const Domain& domain) const {
    double jobs_a_us = 0, longest = 0;
    for (const int c : domain.components) {
      const double period = us(found_.components[at(c)].period_ticks);
      jobs_a_us += static_cast<double>(found_.components[at(c)].xnodes.size()) / period;
      longest = std::max(longest, period);
    }
    const double most = static_cast<double>(kMostWindows) / jobs_a_us;
    if (domain.hyperperiod_ticks && us(*domain.hyperperiod_ticks) <= most)
      return us(*domain.hyperperiod_ticks);
    return longest <= most ? std::floor(most / longest) * longest : most;
  }

  void panel(const Domain& domain) {
    const double span = span_us(domain);
    const double hyper = domain.hyperperiod_ticks ? us(*domain.hyperperiod_ticks) : 0;
    text(8, y_ + 12, "b",
         xml_safe("clock " + app_.clocks[at(domain.clock)].name) +
             (hyper > 0 && span < hyper
                  ? fmt::format(": {:.3f} of {:.3f} ms", span / 1000, hyper / 1000)
              : hyper > 0 ? fmt::format(": repeats every {:.3f} ms", hyper / 1000)
                          : fmt::format(": {:.3f} ms; does not repeat", span / 1000)));
    y_ += 22;
    const int top = y_;
    std::string bars;
    std::swap(bars, out_);
    for (std::size_t x = 0; x < platform_.xpus.size(); ++x)
      for (const int c : domain.components)
        for (const int i : found_.components[at(c)].xnodes)
          if (policy_.placements[at(i)].xpu == static_cast<int>(x)) row(c, i, span);
    std::swap(bars, out_);
    const double step = step_us(span);
    for (double t = 0; t <= span + 1e-6; t += step) {
      const double x = kLeft + kWidth * t / span;
      out_ += fmt::format(
          "<line x1=\"{0:.1f}\" y1=\"{1}\" x2=\"{0:.1f}\" y2=\"{2}\" class=\"grid\"/>\n", x, top,
          y_);
      out_ += fmt::format(
          "<text x=\"{:.1f}\" y=\"{}\" class=\"dim\" text-anchor=\"middle\">{:g}</text>\n", x,
          y_ + 15, t / 1000);
    }
    text(8, y_ + 15, "dim", "ms");
    out_ += bars;
    y_ += kGap;
  }

  void row(int c, int i, double span) {
    const Component& home = found_.components[at(c)];
    const Placement& placed = policy_.placements[at(i)];
    const std::string& name = app_.xnodes[at(i)].name;
    const std::string& xpu = platform_.xpus[at(placed.xpu)].id;
    const std::string& colour = colour_[app_.xnodes[at(i)].module];
    if (xpu != last_xpu_ || y_ != next_y_) text(8, y_ + 13, "dim", clipped(xpu, kMostName));
    last_xpu_ = xpu;
    next_y_ = y_ + kRow;
    out_ += fmt::format("<text x=\"{}\" y=\"{}\" class=\"e\" font-size=\"12\">{}</text>\n",
                        kLeft - 8, y_ + 13, clipped(name, kMostName));
    rect(kLeft, y_ + 1, kWidth, kRow - 2, "lane", "");
    const double period = us(home.period_ticks), phase = us(home.offset_ticks);
    const auto& windows = report_.windows[at(i)];
    double deepest = 0;
    for (const solver::keys::JobWindow& w : windows) deepest = std::max(deepest, w.key_us);
    // There are releases before the first that is drawn.
    for (auto n = static_cast<std::int64_t>(std::floor((-phase - deepest) / period));; ++n) {
      const double release = phase + static_cast<double>(n) * period;
      if (release >= span) break;
      const solver::keys::JobWindow& w = windows[entry(n, windows.size())];
      const bool tight =
          n >= 0 && std::any_of(report_.xpus.begin(), report_.xpus.end(), [&](const auto& proof) {
            return proof.xpu == xpu && proof.xnode == name && proof.activation == n;
          });
      const std::string title =
          fmt::format("{} {} on {}: ready by {:.3f}, key {:.3f} ms", name, n, xpu,
                      (release + w.ready_us) / 1000, (release + w.key_us) / 1000);
      bar(release + w.ready_us, release + w.key_us, span, 2, kRow - 4,
          tight ? "window tight" : "window", colour, title);
      if (!placed.start_us.empty()) {
        const std::size_t j = entry(n, placed.start_us.size());
        bar(release + static_cast<double>(placed.start_us[j]),
            release + static_cast<double>(placed.finish_us[j]), span, 6, kRow - 12, "", colour,
            title);
      }
    }
    y_ += kRow;
  }

  /// What of it is inside the picture.
  void bar(double begin, double end, double span, int down, int height, const char* style,
           const std::string& colour, const std::string& title) {
    begin = std::max(begin, 0.0);
    end = std::min(end, span);
    if (end <= begin) return;
    rect(kLeft + kWidth * begin / span, y_ + down, std::max(0.5, kWidth * (end - begin) / span),
         height, style, colour, title);
  }

  [[nodiscard]] double us(std::int64_t ticks) const {
    return static_cast<double>(ticks) / static_cast<double>(found_.ticks_per_us);
  }
  static std::size_t entry(std::int64_t n, std::size_t size) {
    const auto count = static_cast<std::int64_t>(size);
    return static_cast<std::size_t>(((n % count) + count) % count);
  }

  const AppSpec& app_;
  const Platform& platform_;
  const Policy& policy_;
  const solver::keys::CheckReport& report_;
  const Components found_;
  std::map<std::string, std::string> colour_;  ///< by module
  std::string out_, last_xpu_;
  int y_ = 0, next_y_ = -1;
};

}  // namespace

std::string windows_svg(const AppSpec& app, const Platform& platform, const Policy& policy,
                        const solver::keys::CheckReport& report) {
  return Picture(app, platform, policy, report).draw();
}

}  // namespace xauto::cli
