// SPDX-License-Identifier: Apache-2.0
#include "story/app_graph.h"

#include <algorithm>
#include <map>
#include <numeric>
#include <tuple>
#include <utility>

#include <fmt/format.h>

#include "base/index.h"
#include "story/svg.h"

namespace xauto::story {
namespace {

std::string rate_of(const Period& period) {
  const double hz = 1e6 * static_cast<double>(period.den) / static_cast<double>(period.num);
  return fmt::format("{:.5g} Hz", hz);
}

std::string short_ms(std::int64_t us) {
  return fmt::format("{:g} ms", static_cast<double>(us) / 1000);
}

/// "gpu0, 6 ms"; without a policy "dla 9.4 ms, gpu 6 ms".
std::string place_of(const AppSpec& app, const GraphPlaces& places, std::size_t i) {
  const XNodeSpec& x = app.xnodes[i];
  if (places.platform != nullptr) {
    const Xpu& xpu = places.platform->xpus[at(places.xpu[i])];
    const auto wcet = x.wcet_on(xpu.type);
    return xpu.id + (wcet ? ", " + short_ms(*wcet) : "");
  }
  std::string text;
  for (const auto& [type, us] : x.wcet_us)
    text += (text.empty() ? "" : ", ") + type + " " + short_ms(us);
  return text;
}

/// Graphviz reads HTML's entities in a label, and backslashes.
std::string quoted(const std::string& text) {
  std::string out = "\"";
  for (const char c : text)
    if (c == '"' || c == '\\')
      out += std::string("\\") + c;
    else if (c == '&')
      out += "&amp;";
    else if (static_cast<unsigned char>(c) < 0x20)
      out += "\xEF\xBF\xBD";
    else
      out += c;
  return out + "\"";
}

std::string label(const std::string& first, const std::string& second) {
  std::string text = quoted(first);
  text.pop_back();
  return text + "\\n" + quoted(second).substr(1);
}

std::string source_note(const AppSpec& app, const SourceSpec& source) {
  if (app.one_at_a_time) return "one at a time";
  std::string text = rate_of(source.period);
  if (app.clocks.size() > 1) text += ", clock " + app.clocks[at(source.clock)].name;
  return text;
}

/// [xnode] the slowest source that it hears of, itself or through what fires it; -1: not known.
std::vector<int> slowest_sources(const AppSpec& app) {
  std::vector<int> slowest(app.xnodes.size(), -1);
  const auto slower = [&](int a, int b) {  // a, unless b is slower
    if (a < 0 || b < 0) return std::max(a, b);
    const Period &p = app.sources[at(a)].period, &q = app.sources[at(b)].period;
    return static_cast<double>(q.num) / static_cast<double>(q.den) >
                   static_cast<double>(p.num) / static_cast<double>(p.den)
               ? b
               : a;
  };
  const auto successors = app.successors();
  for (const int i : app.topological_order()) {
    for (const int s : app.xnodes[at(i)].sources) slowest[at(i)] = slower(slowest[at(i)], s);
    for (const int v : successors[at(i)]) slowest[at(v)] = slower(slowest[at(v)], slowest[at(i)]);
  }
  return slowest;
}

constexpr int kCellWidth = 168, kCellHeight = 38, kCellAcross = 216, kMargin = 16, kFirstBand = 46;
constexpr int kCellDown = 74,
              kSampledDown = 96;  // of an app that samples: room for words and lines
constexpr int kBandHead = 44;     // of a band, with its name
constexpr std::size_t kNodeName = 22, kNodeWords = 27;  // bytes that fit into a node
constexpr std::size_t kBelowNode = 34;

constexpr const char* kGraphStyle = R"(<style>
  :root { --fg:#1c1f24; --dim:#5c636e; --line:#d5d9df; --lane:#f4f5f7; --box:#fff }
  @media (prefers-color-scheme: dark) { :root { --fg:#e7e9ed; --dim:#9aa2ae; --line:#3a404a; --lane:#22262d; --box:#14171c } }
  svg { background:var(--box) } text { fill:var(--fg) } .dim { fill:var(--dim); font-size:11px } .b { font-weight:650 }
  .lane { fill:var(--lane) } .module { fill:none; stroke:var(--dim); stroke-opacity:.6 }
  .node { fill:var(--box); stroke-width:2 } .none { stroke:var(--dim) }
  .line { fill:none; stroke:var(--dim); stroke-width:1.3 } .cross { stroke:#0072B2; stroke-width:2.2 } text.crosses { fill:#0072B2; font-size:11px; text-anchor:end }
  .line.sample { stroke:#c2571a; stroke-width:1.8; stroke-dasharray:6 4 } text.samples { fill:#c2571a; font-size:11px }
</style>
<defs><marker id="end" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" markerHeight="7" orient="auto"><path d="M0 0L8 4L0 8z" fill="#808894"/></marker><marker id="read" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="6" markerHeight="6" orient="auto"><path d="M0 0L8 4L0 8z" fill="#c2571a"/></marker></defs>
)";

class Drawing {
 public:
  Drawing(const AppSpec& app, const GraphPlaces& places)
      : app_(app),
        places_(places),
        count_(std::min(app.xnodes.size(), kMostDrawn)),
        down_(app.samples.empty() ? kCellDown : kSampledDown) {}

  std::string draw() {
    place_columns();
    make_bands();
    int y = kFirstBand;
    for (auto& [key, band] : bands_) y = lay_out(band, y);
    std::string boxes;
    for (const auto& [key, band] : bands_) boxes += background(band);
    const std::string arrows = lines();
    std::string nodes;
    for (std::size_t i = 0; i < count_; ++i) nodes += node(i);
    for (std::size_t s = 0; s < app_.sources.size(); ++s) nodes += source(s);
    std::string out =
        text(8, 22, "b", xml_safe(app_.name + on())) + boxes + arrows + nodes + legend(y);
    return fmt::format(
               "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {}\" "
               "font-family=\"system-ui, sans-serif\" font-size=\"13\" role=\"img\" "
               "aria-label=\"Graph of {}\">\n",
               width(), y + 28, xml_safe(app_.name)) +
           kGraphStyle + out + "</svg>\n";
  }

 private:
  struct Cell {
    int column = 0, row = -1;  ///< row: within its band
    int y = 0;
  };
  struct Box {  ///< what one band has of one module
    std::vector<std::size_t> xnodes;
    int first = 0, last = 0, row = 0, height = 1;
  };
  struct Band {
    std::string name;
    std::map<std::string, Box> boxes;  ///< by module
    std::vector<std::size_t> sources;
    std::vector<std::vector<char>> taken;  ///< [row][column]
    int y = 0;
  };

  [[nodiscard]] std::string on() const {
    return places_.platform != nullptr ? " on " + places_.platform->name : "";
  }
  [[nodiscard]] int width() const { return 2 * kMargin + (columns_ + 1) * kCellAcross; }

  /// Steps from the source on, along what fires; what samples stands behind what it reads, unless
  /// that goes in a circle.
  void place_columns() {
    cells_.resize(count_);
    for (Cell& cell : cells_) cell.column = 1;
    const auto successors = app_.successors();
    const std::vector<int> order = app_.topological_order();
    const auto drawn = [&](int u, int v) { return at(u) < count_ && at(v) < count_; };
    std::vector<int> part(count_);  // XNodes joined by edges move together
    std::iota(part.begin(), part.end(), 0);
    const auto head = [&](int i) {
      while (part[at(i)] != i) i = part[at(i)] = part[at(part[at(i)])];
      return i;
    };
    for (const int u : order)
      for (const int v : successors[at(u)])
        if (drawn(u, v)) {
          cells_[at(v)].column = std::max(cells_[at(v)].column, cells_[at(u)].column + 1);
          part[at(head(u))] = head(v);
        }
    std::vector<std::vector<std::pair<int, int>>> readers(count_);  // [part] (u, v) that leave it
    const auto reaches = [&](int from, int to) {
      std::vector<char> seen(count_, 0);
      std::vector<int> front = {from};
      while (!front.empty()) {
        const int c = front.back();
        front.pop_back();
        if (c == to) return true;
        if (std::exchange(seen[at(c)], 1) != 0) continue;
        for (const auto& [u, v] : readers[at(c)]) front.push_back(head(v));
      }
      return false;
    };
    std::size_t tried = 0;
    for (const auto& [u, v] : app_.samples)
      if (drawn(u, v) && ++tried <= kMostLines && !reaches(head(v), head(u)))
        readers[at(head(u))].emplace_back(u, v);
    std::vector<int> shift(count_, 0);
    for (bool again = true; again;) {  // ends: there is no circle in `readers`
      again = false;
      for (const auto& list : readers)
        for (const auto& [u, v] : list) {
          const int least = cells_[at(u)].column + shift[at(head(u))] + 1 - cells_[at(v)].column;
          if (shift[at(head(v))] >= least) continue;
          shift[at(head(v))] = least;
          again = true;
        }
    }
    for (std::size_t i = 0; i < count_; ++i) {
      cells_[i].column += shift[at(head(static_cast<int>(i)))];
      columns_ = std::max(columns_, cells_[i].column);
    }
  }

  Band& band_of(int source, int host) {
    const std::string on = host < 0 ? "" : "host " + places_.platform->hosts[at(host)].name + ", ";
    if (source < 0) {
      Band& band = bands_[{host, -1, 0}];
      band.name = on + "how often is not known";
      return band;
    }
    const SourceSpec& s = app_.sources[at(source)];
    Band& band = bands_[{host, s.clock,
                         static_cast<double>(s.period.num) / static_cast<double>(s.period.den)}];
    band.name = on + source_note(app_, s);
    return band;
  }

  void make_bands() {
    const std::vector<int> slowest = slowest_sources(app_);
    for (std::size_t i = 0; i < count_; ++i)
      band_of(slowest[i], places_.host(static_cast<int>(i)))
          .boxes[app_.xnodes[i].module]
          .xnodes.push_back(i);
    std::vector<int> heard_by(app_.sources.size(), -1);  // the first
    for (std::size_t i = count_; i-- > 0;)
      for (const int s : app_.xnodes[i].sources) heard_by[at(s)] = static_cast<int>(i);
    source_cells_.resize(app_.sources.size());
    for (std::size_t s = 0; s < heard_by.size(); ++s)
      if (heard_by[s] >= 0)
        band_of(static_cast<int>(s), places_.host(heard_by[s])).sources.push_back(s);
  }

  /// The first rows, from `wanted` on, that are free from column `first` to `last`.
  int take_rows(Band& band, int first, int last, int height, int wanted) const {
    const auto is_free = [&](int row) {
      for (int r = row; r < row + height; ++r)
        if (at(r) < band.taken.size())
          for (int c = first; c <= last; ++c)
            if (band.taken[at(r)][at(c)] != 0) return false;
      return true;
    };
    int row = wanted;
    if (!is_free(row))
      for (row = 0; !is_free(row);) ++row;
    while (band.taken.size() < at(row + height)) band.taken.emplace_back(at(columns_ + 1), 0);
    for (int r = row; r < row + height; ++r)
      for (int c = first; c <= last; ++c) band.taken[at(r)][at(c)] = 1;
    return row;
  }

  /// Gives every cell of the band its place; returns where the next band begins.
  int lay_out(Band& band, int y) {
    band.y = y;
    std::vector<Box*> order;
    for (auto& [module, box] : band.boxes) {
      std::map<int, int> depth;  // XNodes of one column stand below each other
      box.first = columns_;
      for (const std::size_t i : box.xnodes) {
        Cell& cell = cells_[i];
        cell.row = depth[cell.column]++;
        box.height = std::max(box.height, cell.row + 1);
        box.first = std::min(box.first, cell.column);
        box.last = std::max(box.last, cell.column);
      }
      order.push_back(&box);
    }
    std::sort(order.begin(), order.end(), [](const Box* a, const Box* b) {
      return std::tie(a->first, a->xnodes.front()) < std::tie(b->first, b->xnodes.front());
    });
    std::vector<char> done(count_, 0);
    for (Box* box : order) {
      int wanted = 0;  // beside what fires it
      for (const auto& [u, v] : app_.edges)
        if (at(u) < count_ && done[at(u)] != 0 && at(v) == box->xnodes.front()) {
          wanted = cells_[at(u)].row;
          break;
        }
      box->row = take_rows(band, box->first, box->last, box->height, wanted);
      for (const std::size_t i : box->xnodes) {
        cells_[i].row += box->row;
        cells_[i].y = y + kBandHead + cells_[i].row * down_;
        done[i] = 1;
      }
    }
    for (const std::size_t s : band.sources) {
      int column = columns_, wanted = 0;  // before the first that hears of it
      for (std::size_t i = 0; i < count_; ++i)
        if (const auto& heard = app_.xnodes[i].sources;
            std::find(heard.begin(), heard.end(), static_cast<int>(s)) != heard.end() &&
            cells_[i].column - 1 < column) {
          column = cells_[i].column - 1;
          wanted = done[i] != 0 ? cells_[i].row : 0;
        }
      source_cells_[s] = {column, take_rows(band, column, column, 1, wanted), 0};
      source_cells_[s].y = y + kBandHead + source_cells_[s].row * down_;
    }
    return y + kBandHead + static_cast<int>(band.taken.size()) * down_;
  }

  static int x_of(int column) { return kMargin + column * kCellAcross; }

  static std::string text(int x, int y, const char* style, const std::string& safe) {
    return fmt::format("<text x=\"{}\" y=\"{}\" class=\"{}\">{}</text>\n", x, y, style, safe);
  }

  [[nodiscard]] std::string background(const Band& band) const {
    const int rows = static_cast<int>(band.taken.size());
    std::string out =
        fmt::format("<rect x=\"4\" y=\"{}\" width=\"{}\" height=\"{}\" rx=\"6\" class=\"lane\"/>\n",
                    band.y, width() - 8, kBandHead + rows * down_ - 8);
    out += text(12, band.y + 17, "b", xml_safe(band.name));
    for (const auto& [module, box] : band.boxes) {
      const int y = band.y + kBandHead + box.row * down_ - 18;
      out += fmt::format(
          "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" rx=\"8\" class=\"module\"/>\n",
          x_of(box.first) - 8, y, (box.last - box.first) * kCellAcross + kCellWidth + 16,
          (box.height - 1) * down_ + kCellHeight + 26 + (down_ - kCellDown) / 2);
      out += text(x_of(box.first), y + 13, "dim", clipped(module, kNodeWords));
    }
    return out;
  }

  /// From the right side of one to the left side of the other.
  static std::string arrow(const Cell& from, const Cell& to, const std::string& title,
                           const std::string& crossing = {}) {
    const int x1 = x_of(from.column) + kCellWidth, y1 = from.y + kCellHeight / 2;
    const int x2 = x_of(to.column), y2 = to.y + kCellHeight / 2;
    const int bend = x2 > x1 ? std::max(24, (x2 - x1) / 2) : 80;
    return fmt::format(
               "<path d=\"M{} {}C{} {} {} {} {} {}\" class=\"line{}\" marker-end=\"url(#end)\">"
               "<title>{}</title></path>\n",
               x1, y1, x1 + bend, y1, x2 - bend, y2, x2, y2, crossing.empty() ? "" : " cross",
               xml_safe(title)) +
           (crossing.empty() ? "" : text(x2 - 2, y2 - 5, "crosses", crossing));
  }

  /// Never behind a node: down beside who is sampled, along below its row, and to the reader from the left. What leaves one
  /// XNode shares a lane.
  static std::string sample_line(const Cell& from, const Cell& to, int lane,
                                 const std::string& title) {
    const int x1 = x_of(from.column) + kCellWidth, x2 = x_of(to.column);
    const int gap = 14 + 4 * (lane % 5), below = from.y + kSampledDown - 34 + 3 * (lane % 4);
    const int y1 = from.y + kCellHeight / 2 + 3 * (lane % 4) + 3, y2 = to.y + kCellHeight / 2 + 6;
    const std::string along = to.column == from.column + 1
                                  ? fmt::format("H{}", x1 + gap)
                                  : fmt::format("H{}V{}H{}", x1 + gap, below, x2 - 48 + gap);
    return fmt::format(
        "<path d=\"M{} {}{}V{}H{}\" class=\"line sample\" marker-end=\"url(#read)\">"
        "<title>{}</title></path>\n",
        x1, y1, along, y2, x2, xml_safe(title));
  }

  std::string lines() {
    std::string out;
    const auto one_more = [&](bool drawn) {
      ++lines_;
      if (!drawn || drawn_lines_ == kMostLines) return false;
      ++drawn_lines_;
      return true;
    };
    for (std::size_t i = 0; i < app_.xnodes.size(); ++i)
      for (const int s : app_.xnodes[i].sources)
        if (one_more(i < count_))
          out += arrow(source_cells_[at(s)], cells_[i],
                       app_.sources[at(s)].name + " fires " + app_.xnodes[i].name);
    for (const auto& [u, v] : app_.edges)
      if (one_more(at(u) < count_ && at(v) < count_))
        out += arrow(cells_[at(u)], cells_[at(v)],
                     app_.xnodes[at(u)].name + " before " + app_.xnodes[at(v)].name,
                     places_.crossing(u, v));
    std::map<int, int> lanes;  // by who is sampled
    for (const auto& [u, v] : app_.samples)
      if (one_more(at(u) < count_ && at(v) < count_))
        out += sample_line(cells_[at(u)], cells_[at(v)],
                           lanes.try_emplace(u, static_cast<int>(lanes.size())).first->second,
                           app_.xnodes[at(v)].name + " samples " + app_.xnodes[at(u)].name);
    return out;
  }

  /// Colours are of XPU types, in the platform's order.
  [[nodiscard]] const char* colour(const std::string& type) const {
    const std::vector<std::string> types = places_.platform->types();
    const auto found = std::find(types.begin(), types.end(), type);
    return kColours[static_cast<std::size_t>(found - types.begin()) % std::size(kColours)];
  }

  [[nodiscard]] std::string node(std::size_t i) const {
    const Cell& cell = cells_[i];
    const std::string place = place_of(app_, places_, i);
    const std::string style =
        places_.platform == nullptr
            ? "class=\"node none\""
            : fmt::format("class=\"node\" stroke=\"{}\"",
                          colour(places_.platform->xpus[at(places_.xpu[i])].type));
    return fmt::format(
               "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" rx=\"4\" "
               "{}><title>{}</title></rect>\n",
               x_of(cell.column), cell.y, kCellWidth, kCellHeight, style,
               xml_safe(app_.xnodes[i].name + " of XModule " + app_.xnodes[i].module + ": " +
                        place)) +
           text(x_of(cell.column) + 8, cell.y + 16, "", clipped(app_.xnodes[i].name, kNodeName)) +
           text(x_of(cell.column) + 8, cell.y + 31, "dim", clipped(place, kNodeWords)) +
           sampled_by(i);
  }

  /// Below the node: whose newest result it reads.
  [[nodiscard]] std::string sampled_by(std::size_t i) const {
    std::string names;
    for (const auto& [u, v] : app_.samples)
      if (at(v) == i) {
        const std::string crossing = places_.crossing(u, v);
        names += (names.empty() ? "samples " : ", ") + app_.xnodes[at(u)].name +
                 (crossing.empty() ? "" : " (" + crossing + ")");
      }
    if (names.empty()) return {};
    return text(x_of(cells_[i].column), cells_[i].y + kCellHeight + 13, "samples",
                clipped(names, kBelowNode));
  }

  [[nodiscard]] std::string source(std::size_t s) const {
    const Cell& cell = source_cells_[s];
    if (cell.row < 0) return {};  // of what is not drawn
    const std::string note = source_note(app_, app_.sources[s]);
    return fmt::format(
               "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" rx=\"19\" class=\"node none\">"
               "<title>{}</title></rect>\n",
               x_of(cell.column), cell.y, kCellWidth, kCellHeight,
               xml_safe("source " + app_.sources[s].name + ": " + note)) +
           text(x_of(cell.column) + 14, cell.y + 16, "", clipped(app_.sources[s].name, kNodeName)) +
           text(x_of(cell.column) + 14, cell.y + 31, "dim", clipped(note, kNodeWords));
  }

  [[nodiscard]] std::string legend(int y) const {
    std::string words =
        "solid: fires; dashed, with an arrow at who reads: its newest result is sampled";
    if (count_ < app_.xnodes.size() || drawn_lines_ < lines_)
      words += fmt::format("; drawn are {} of {} XNodes, {} of {} arrows (--dot has all)", count_,
                           app_.xnodes.size(), drawn_lines_, lines_);
    std::string out = text(8, y + 14, "dim", words);
    if (places_.platform == nullptr) return out;
    int x = 560;
    for (const std::string& type : places_.platform->types()) {
      if (count_ < app_.xnodes.size() || drawn_lines_ < lines_) break;  // the words need the room
      out += fmt::format(
          "<rect x=\"{}\" y=\"{}\" width=\"12\" height=\"10\" class=\"node\" stroke=\"{}\"/>\n", x,
          y + 5, colour(type));
      out += text(x + 18, y + 14, "dim", clipped(type, kNodeName));
      x += 60 + 7 * static_cast<int>(std::min(type.size(), kNodeName));
    }
    return out;
  }

  const AppSpec& app_;
  const GraphPlaces& places_;
  const std::size_t count_;  ///< of XNodes: the first ones are drawn
  const int down_;           ///< from one row to the next
  int columns_ = 1;
  std::vector<Cell> cells_, source_cells_;
  std::map<std::tuple<int, int, double>, Band> bands_;  ///< by host, clock, period
  std::size_t lines_ = 0, drawn_lines_ = 0;
};

}  // namespace

std::string GraphPlaces::crossing(int u, int v) const {
  if (host(u) == host(v)) return {};
  const auto found = std::ranges::find_if(
      crossings, [&](const Crossing& c) { return c.from == u && c.host == host(v); });
  return found == crossings.end() ? std::string("no X") : "X " + short_ms(found->x_us);
}

std::string graph_dot(const AppSpec& app, const GraphPlaces& places) {
  std::string out = "digraph " + quoted(app.name) + " {\n  rankdir=LR;\n  node [shape=box];\n";
  for (std::size_t s = 0; s < app.sources.size(); ++s)
    out += fmt::format("  s{} [shape=ellipse, label={}];\n", s,
                       label(app.sources[s].name, source_note(app, app.sources[s])));
  std::map<int, std::map<std::string, std::vector<std::size_t>>> hosts;  // of modules
  for (std::size_t i = 0; i < app.xnodes.size(); ++i)
    hosts[places.host(static_cast<int>(i))][app.xnodes[i].module].push_back(i);
  std::size_t number = 0;
  for (const auto& [host, modules] : hosts) {
    if (host >= 0)
      out += fmt::format("  subgraph cluster_host{} {{\n    label={}; style=dashed;\n", host,
                         quoted("host " + places.platform->hosts[at(host)].name));
    for (const auto& [module, xnodes] : modules) {
      out += fmt::format("  subgraph cluster_{} {{\n    label={};{}\n", number++, quoted(module),
                         host < 0 ? "" : " style=solid;");
      for (const std::size_t i : xnodes)
        out += fmt::format("    x{} [label={}];\n", i,
                           label(app.xnodes[i].name, place_of(app, places, i)));
      out += "  }\n";
    }
    if (host >= 0) out += "  }\n";
  }
  for (std::size_t i = 0; i < app.xnodes.size(); ++i)
    for (const int s : app.xnodes[i].sources) out += fmt::format("  s{} -> x{};\n", s, i);
  for (const auto& [u, v] : app.edges) {
    const std::string crossing = places.crossing(u, v);
    out += fmt::format("  x{} -> x{}{};\n", u, v,
                       crossing.empty()
                           ? ""
                           : " [color=\"#0072B2\", fontcolor=\"#0072B2\", penwidth=2, label=" +
                                 quoted(crossing) + "]");
  }
  for (const auto& [u, v] : app.samples) {
    const std::string crossing = places.crossing(u, v);
    out += fmt::format(
        "  x{} -> x{} [style=dashed, constraint=false, color=\"#c2571a\", fontcolor=\"#c2571a\", "
        "label={}];\n",
        u, v, quoted("sampled" + (crossing.empty() ? "" : ", " + crossing)));
  }
  return out + "}\n";
}

std::string graph_svg(const AppSpec& app, const GraphPlaces& places) {
  return Drawing(app, places).draw();
}

}  // namespace xauto::story
