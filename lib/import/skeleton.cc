// SPDX-License-Identifier: Apache-2.0
#include "import/skeleton.h"

#include <algorithm>
#include <cctype>
#include <map>
#include <set>

#include <fmt/format.h>

#include "base/index.h"

namespace xauto::import {
namespace {

constexpr const char* kCMake =
    R"(# Made by `xauto import --cpp`; it is yours now.   cmake -B build && cmake --build build
cmake_minimum_required(VERSION 3.18)
project({0} LANGUAGES CXX)

find_package(xauto {1} REQUIRED)

add_executable({0} main.cc)
target_link_libraries({0} PRIVATE xauto::xauto)
)";

constexpr const char* kBegin =
    R"(// Made by `xauto import --cpp`; it is yours now. Fill in what says TODO.
//
//   cmake -B build && cmake --build build
//   xauto solve --app app.json --platform large --out policy.json
//   xauto run --app app.json --policy policy.json -- build/{0}
//
// Until then each XNode keeps an emulated XPU busy for as long as times.h says.
{1}#include <chrono>
#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <xauto/emu.h>
#include <xauto/xauto.h>

#include "times.h"

namespace {{

/// TODO: the types of your topics, one for each.
struct Message {{
  std::uint64_t number = 0;
}};
/// TODO: what the XNodes of a module hand on to each other.
struct State {{
  Message result;
}};
using Node = xauto::XNode<State>;
using Module = xauto::XModule<State>;
using Topic = xauto::Topic<Message>;

/// An emulated XPU instead of work. TODO: it goes when the last XNode does its own.
void stand_in(Node& node, const char* type, const std::vector<std::int64_t>& times_us,
              xauto::Status (*work)(State&, const xauto::Input&)) {{
  node.add_impl(
      xauto::XPU(type),
      [](const xauto::XpuId& id) {{
        auto opened = xauto::emu::Context::open(id);
        if (!opened) throw std::runtime_error(opened.error().to_string());
        const xauto::SchedHandle handle = opened->handle();
        return xauto::own(std::make_unique<xauto::emu::Context>(std::move(*opened)), handle);
      }},
      [&times_us, work](xauto::emu::Context& context, State& state, const xauto::Input& input) {{
        const std::int64_t us = times_us[input.sequence() % times_us.size()];
        auto done = context.run(std::chrono::microseconds(us));
        return done ? work(state, input) : done;
      }});
}}

)";

/// The longest line of numbers in times.h.
constexpr std::size_t kColumns = 100;
/// The emulator wakes up a little late.
constexpr std::int64_t kWakeUs = 300;
constexpr std::size_t kDrawn = 16;  ///< times of an XNode that nobody has seen

/// What may be a name in C++ and CMake, and no other one is.
class Identifiers {
 public:
  std::string of(const std::string& name) {
    std::string id;
    for (const char c : name) id += std::isalnum(static_cast<unsigned char>(c)) != 0 ? c : '_';
    if (id.empty() || std::isdigit(static_cast<unsigned char>(id[0])) != 0) id.insert(0, "x_");
    std::string unique = id;
    for (int n = 2; !taken_.insert(unique).second; ++n) unique = id + "_" + std::to_string(n);
    return unique;
  }

 private:
  std::set<std::string> taken_;
};

/// A text literal.
std::string quoted(const std::string& text) {
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') out += '\\';
    out += c;
  }
  return out + "\"";
}

/// For a comment: a name may have no end of line, but a backslash at its end would join two lines.
std::string commented(std::string text) {
  std::ranges::replace(text, '\\', '/');
  return text;
}

class Skeleton {
 public:
  explicit Skeleton(const ImportedApp& imported)
      : imported_(imported), app_(imported.app), seen_(imported.seen) {
    for (const int x : app_.topological_order()) xnodes_[app_.xnodes[at(x)].module].push_back(x);
    for (const XNodeSpec& x : app_.xnodes) ids_.push_back(identifiers_.of(x.name));
  }

  Result<std::vector<SkeletonFile>> files(const std::string& version) {
    const std::string project = Identifiers().of(app_.name);
    std::string main = fmt::format(kBegin, project, gates());
    for (std::size_t x = 0; x < app_.xnodes.size(); ++x) main += work(x);
    main += "}  // namespace\n\nint main(int argc, char** argv) {\n  xauto::App app(" +
            quoted(app_.name) + ");\n" + sources();
    for (const ModuleSpec& m : app_.modules) {
      XAUTO_ASSIGN(const std::string text, module(m));
      main += text;
    }
    main += "  return app.main(argc, argv);\n}\n";
    return std::vector<SkeletonFile>{{"CMakeLists.txt", fmt::format(kCMake, project, version)},
                                     {"main.cc", std::move(main)},
                                     {"times.h", times()},
                                     {"app.json", to_json(imported_)}};
  }

 private:
  /// Of a ROS 2 program: how to keep its callbacks as they are.
  [[nodiscard]] std::string gates() const {
    if (seen_.executors.empty()) return "";
    const std::vector<std::int64_t> periods = app_.periods();
    std::string text =
        "//\n// Or keep the callbacks as they are: each in a callback group of its own, made with\n"
        "// automatically_add_to_executor_with_node false, and a gate each instead of "
        "rclcpp::spin.\n"
        "// Then `xauto profile` anew: a gate is an app's module of its own, fired by what rclcpp "
        "has.\n"
        "//\n//   #include <xauto/ros2.h>\n";
    Identifiers gates;
    for (std::size_t x = 0; x < app_.xnodes.size(); ++x) {
      const std::string id = gates.of(app_.xnodes[x].name);
      text += fmt::format(
          "//   xauto::Ros2Gate {0}(app, {1}, std::chrono::microseconds({2}));\n"
          "//   {0}.add_callback_group(its_group, its_node);\n",
          id, commented(quoted(app_.xnodes[x].name)), periods[x] * 9 / 10);
    }
    return text;
  }

  [[nodiscard]] std::string work(std::size_t x) const {
    return fmt::format(
        "/// {}\nxauto::Status work_{}(State& state, const xauto::Input& input) {{\n"
        "  state.result.number = input.sequence();  // TODO: its work\n  return {{}};\n}}\n\n",
        commented(app_.xnodes[x].name), ids_[x]);
  }

  [[nodiscard]] std::string sources() const {
    std::string text;
    for (const SourceSpec& s : app_.sources)
      text += fmt::format(
          "  app.add_source(Topic({}), std::chrono::microseconds({}),\n"
          "                 [](std::uint64_t number) {{ return Message{{number}}; }});"
          "  // TODO: its driver\n",
          quoted(s.name), app_.one_at_a_time ? 1000 : s.period.floor_us());
    return text + "\n";
  }

  static std::string result_of(const std::string& module) { return quoted("of/" + module); }

  /// Whether this leads from one module into another. Errors: no program has it.
  Result<bool> leads(const std::pair<int, int>& pair) const {
    const std::string &from = app_.xnodes[at(pair.first)].module,
                      &to = app_.xnodes[at(pair.second)].module;
    if (from == to) return false;
    if (xnodes_.at(from).back() != pair.first || xnodes_.at(to).front() != pair.second)
      return fail(ErrorCode::kInvalid,
                  "no program has an edge or sample like that from '" +
                      app_.xnodes[at(pair.first)].name + "' to '" +
                      app_.xnodes[at(pair.second)].name + "'",
                  "--cpp", "let it lead from the last XNode of a module to the first of another");
    return true;
  }

  Result<std::string> module(const ModuleSpec& spec) {
    const std::string id = identifiers_.of("module_" + spec.name);
    std::string text = fmt::format("  Module {}({});\n", id, quoted(spec.name));
    if (spec.max_in_flight > 1)
      text += fmt::format("  {}.in_flight({});\n", id, spec.max_in_flight);
    const std::vector<int>& xnodes = xnodes_.at(spec.name);
    for (const int x : xnodes) {
      const XNodeSpec& xnode = app_.xnodes[at(x)];
      text += fmt::format("  Node {}({});\n", ids_[at(x)], quoted(xnode.name));
      int n = 0;
      for (const auto& [type, us] : xnode.wcet_us)
        text += fmt::format("  stand_in({0}, {1}, times_{0}_{2}, work_{0});\n", ids_[at(x)],
                            quoted(type), n++);
      text += fmt::format("  {}.add_node({});\n", id, ids_[at(x)]);
    }
    for (const int s : app_.xnodes[at(xnodes.front())].sources)
      text +=
          fmt::format("  {}.add_input_topic(Topic({}));\n", id, quoted(app_.sources[at(s)].name));
    for (const auto* const list : {&app_.edges, &app_.samples})
      for (const auto& pair : *list) {
        if (app_.xnodes[at(pair.second)].module != spec.name) continue;
        XAUTO_ASSIGN(const bool outside, leads(pair));
        if (outside)
          text += fmt::format("  {}.{}(Topic({}));\n", id,
                              list == &app_.edges ? "add_input_topic" : "add_sampled_topic",
                              result_of(app_.xnodes[at(pair.first)].module));
      }
    return text + fmt::format(
                      "  {0}.add_output_topic(Topic({1}), &State::result);\n"
                      "  app.add_module({0});\n\n",
                      id, result_of(spec.name));
  }

  /// What a stand-in takes on a type: as was seen on a CPU, in proportion to the WCETs.
  [[nodiscard]] std::vector<std::int64_t> times_on(std::size_t x, std::int64_t wcet_us) const {
    const std::int64_t most =
        std::max(wcet_us - kWakeUs, std::max<std::int64_t>(1, wcet_us * 3 / 10));
    std::vector<std::int64_t> times;
    if (x < seen_.xnodes.size() && !seen_.xnodes[x].times_us.empty()) {
      const auto seen_on = static_cast<double>(app_.xnodes[x].wcet_on("cpu").value_or(wcet_us));
      for (const std::int64_t us : seen_.xnodes[x].times_us)
        times.push_back(static_cast<std::int64_t>(static_cast<double>(us) *
                                                  static_cast<double>(wcet_us) / seen_on));
    } else {
      for (std::size_t n = 0; n < kDrawn; ++n)
        times.push_back(wcet_us * static_cast<std::int64_t>(60 + 35 * ((n * 7) % kDrawn) / kDrawn) /
                        100);
    }
    for (std::int64_t& us : times) us = std::clamp<std::int64_t>(us, 1, most);
    return times;
  }

  [[nodiscard]] std::string times() const {
    std::string text =
        "// Made by `xauto import --cpp`: how long each XNode takes on each type of XPU, in "
        "microseconds.\n#pragma once\n\n#include <cstdint>\n#include <vector>\n";
    for (std::size_t x = 0; x < app_.xnodes.size(); ++x) {
      int n = 0;
      for (const auto& [type, wcet_us] : app_.xnodes[x].wcet_us) {
        text +=
            fmt::format("\n// {} on {}\ninline const std::vector<std::int64_t> times_{}_{} = {{\n",
                        commented(app_.xnodes[x].name), commented(type), ids_[x], n++);
        std::string line = "   ";
        for (const std::int64_t us : times_on(x, wcet_us)) {
          if (line.size() > kColumns) {
            text += line + "\n";
            line = "   ";
          }
          line += fmt::format(" {},", us);
        }
        text += line + "};\n";
      }
    }
    return text;
  }

  const ImportedApp& imported_;
  const AppSpec& app_;
  const Seen& seen_;
  std::map<std::string, std::vector<int>> xnodes_;  ///< [module] in their order
  Identifiers identifiers_;
  std::vector<std::string> ids_;  ///< [xnode]
};

}  // namespace

Result<std::vector<SkeletonFile>> skeleton(const ImportedApp& imported,
                                           const std::string& version) {
  return Skeleton(imported).files(version);
}

}  // namespace xauto::import
