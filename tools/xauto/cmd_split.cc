// SPDX-License-Identifier: Apache-2.0
// xauto split: an ONNX model in parts that are models, each an XNode, so that a net may run on several XPUs.
#include <algorithm>
#include <charconv>
#include <filesystem>
#include <iostream>
#include <map>
#include <memory>

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include "base/columns.h"
#include "base/process.h"
#include "base/unique_fd.h"
#include "model/imported.h"
#include "model/json.h"
#include "model/json_value.h"

#include "import/onnx_net.h"
#include "xauto/command.h"
#include "xauto/objectives_file.h"
#include "xauto/outputs.h"

namespace xauto::cli {
namespace {

namespace fs = std::filesystem;
using import::LayerTimes;
using import::OnnxCut;
using import::OnnxNet;
using import::OnnxPart;

constexpr int kCheckMs = 10 * 60 * 1000;

struct SplitFlags {
  std::string net, policy, out, name;
  std::vector<std::string> at, layers;
  std::int64_t tensors = 1, margin_pct = 0;
};

struct Split {
  std::vector<OnnxCut> at;
  std::vector<LayerTimes> times;
  ImportedApp app;
  std::vector<OnnxPart> parts;
  std::vector<std::string> files, lines;
  bool equal = true;
};

std::string name_of(const SplitFlags& flags) {
  return flags.name.empty() ? fs::path(flags.net).stem().string() : flags.name;
}

Result<std::vector<LayerTimes>> read_times(const SplitFlags& flags, const OnnxNet& net,
                                           std::vector<std::string>& lines) {
  std::vector<LayerTimes> times;
  for (const std::string& text : flags.layers) {
    XAUTO_ASSIGN(const auto parts, parse_assignment(text, "--layers"));
    XAUTO_ASSIGN(const std::string json, read_file(parts.second));
    XAUTO_ASSIGN(const auto layers, import::parse_trtexec_profile(json, parts.second));
    XAUTO_ASSIGN(LayerTimes one, import::times_of_nodes(net, parts.first, layers, parts.second));
    if (one.unnamed > 0)
      lines.push_back(fmt::format(
          "{}: {:.1f} % of the time is of layers that name no node of the net: it counts "
          "for the node before",
          parts.first, 100 * one.unnamed));
    times.push_back(std::move(one));
  }
  return times;
}

std::string text_of(const OnnxCut& cut, const OnnxNet& net) {
  std::string tensors;
  for (const std::string& name : cut.tensors)
    tensors += (tensors.empty() ? "'" : ", '") + name + "'";
  return fmt::format("behind '{}': {}{}", net.nodes()[cut.after - 1],
                     tensors.empty() ? "nothing crosses" : tensors,
                     cut.bytes > 0 ? fmt::format(", {} bytes", cut.bytes) : "");
}

/// --at as a number of cuts; none: it is the name of a tensor.
std::optional<std::size_t> number_of(const std::string& text) {
  std::size_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return value;
}

Result<std::vector<OnnxCut>> cuts_behind(const SplitFlags& flags, const OnnxNet& net) {
  std::map<std::size_t, OnnxCut> chosen;
  for (const std::string& tensor : flags.at) {
    const OnnxCut* cut = net.cut_behind(tensor);
    if (cut == nullptr)
      return fail(ErrorCode::kNotFound, "is no tensor behind which the net can be cut",
                  "--at " + tensor, "name the output of a node that has others behind it");
    chosen.emplace(cut->after, *cut);
  }
  std::vector<OnnxCut> at;
  for (const auto& [after, cut] : chosen) at.push_back(cut);
  return at;
}

Result<std::vector<OnnxCut>> choose(const SplitFlags& flags, const OnnxNet& net,
                                    const std::vector<LayerTimes>& times,
                                    std::vector<std::string>& lines) {
  if (flags.at.size() != 1 || !number_of(flags.at.front())) return cuts_behind(flags, net);
  const std::size_t count = *number_of(flags.at.front());
  if (count < 1 || count >= import::kMaxParts)
    return fail(ErrorCode::kInvalid, "is no number of cuts from 1 to 64",
                "--at " + flags.at.front(), "");
  std::vector<OnnxCut> cuts = net.cuts(static_cast<std::size_t>(flags.tensors));
  const std::size_t there = cuts.size();
  std::erase_if(cuts, [&](const OnnxCut& cut) {
    return std::ranges::any_of(times, [&](const LayerTimes& t) { return t.fused[cut.after - 1]; });
  });
  lines.push_back(fmt::format(
      "{} places where at most {} crosses{}{}", there,
      flags.tensors == 1 ? "one tensor" : fmt::format("{} tensors", flags.tensors),
      there == cuts.size() ? "" : fmt::format(", {} of them inside no layer", cuts.size()),
      net.untyped() == 0 ? ""
                         : fmt::format("; {} more cross a tensor whose type is not stated "
                                       "(onnx.shape_inference writes it)",
                                       net.untyped())));
  if (cuts.size() < count)
    return fail(ErrorCode::kInvalid,
                fmt::format("has {} places to be cut, and not {}", cuts.size(), count), flags.net,
                "ask for fewer, or let more tensors cross (--tensors)");
  return import::even_cuts(net, cuts, times, count);
}

/// The cuts between parts that the policy has on different XPUs.
Result<std::vector<OnnxCut>> join(const SplitFlags& flags, const std::vector<OnnxCut>& at,
                                  std::vector<std::string>& lines) {
  XAUTO_ASSIGN(const std::string text, read_file(flags.policy));
  std::optional<Json> policy = Json::parse(text);
  std::map<std::string, std::string> on;
  if (policy && policy->is_object() && policy->at("xnodes").is_array())
    for (const Json& xnode : policy->at("xnodes").elements())
      if (xnode.is_object() && xnode.at("name").text() && xnode.at("xpu").text())
        on[*xnode.at("name").text()] = *xnode.at("xpu").text();
  std::vector<OnnxCut> kept;
  for (std::size_t p = 0; p <= at.size(); ++p) {
    const std::string name = name_of(flags) + "." + std::to_string(p + 1);
    if (!on.contains(name))
      return fail(ErrorCode::kInvalid, "has no XNode '" + name + "'", flags.policy,
                  "solve the app.json that this command makes without --policy");
    if (p == 0) continue;
    const std::string before = name_of(flags) + "." + std::to_string(p);
    if (on.at(before) == on.at(name)) continue;
    kept.push_back(at[p - 1]);
  }
  std::string xpus;
  for (std::size_t p = 0; p <= at.size(); ++p) {
    const std::string& xpu = on.at(name_of(flags) + "." + std::to_string(p + 1));
    if (p == 0 || xpu != on.at(name_of(flags) + "." + std::to_string(p)))
      xpus += (xpus.empty() ? "" : ", ") + xpu;
  }
  lines.push_back(
      fmt::format("{} parts are {} by the policy: on {}", at.size() + 1, kept.size() + 1, xpus));
  return kept;
}

/// Parts lie where the net's other files are.
Status copy_external(const OnnxNet& net, const SplitFlags& flags) {
  XAUTO_ASSIGN(const std::vector<std::string> files, net.external_files());
  for (const std::string& file : files) {
    const fs::path from = fs::path(flags.net).parent_path() / file, to = fs::path(flags.out) / file;
    std::error_code error;
    if (fs::equivalent(from, to, error)) continue;
    if (!fs::is_regular_file(fs::symlink_status(from, error)))
      return fail(ErrorCode::kNotFound, "holds tensors of the net, and is no file", from.string(),
                  "put it there");
    fs::create_directories(to.parent_path(), error);
    if (!fs::copy_file(from, to, fs::copy_options::overwrite_existing, error))
      return fail(ErrorCode::kIo, "cannot be copied: " + error.message(), from.string(), "");
  }
  return {};
}

/// By ONNX Runtime, in a child. What is no answer is a line.
void check_equal(const SplitFlags& flags, Split& split) {
  const std::string program = program_directory() + "/xauto-onnxcheck";
  if (access(program.c_str(), X_OK) != 0) {
    split.lines.push_back(
        "NOT CHECKED that the parts compute what the whole does: ONNX Runtime was not there when "
        "this was built");
    return;
  }
  SpawnOptions options;
  options.argv = {program, flags.net};
  options.argv.insert(options.argv.end(), split.files.begin(), split.files.end());
  auto child = Child::spawn(options);
  const auto ended = child ? child->wait(kCheckMs) : std::optional<xauto::Exit>();
  if (ended && !ended->signalled && !ended->unknown && ended->value == 0) {
    split.lines.push_back(
        "checked by ONNX Runtime: the parts compute what the whole does, bit by bit");
  } else if (ended && !ended->signalled && !ended->unknown && ended->value == 1) {
    split.equal = false;
    split.lines.push_back("ONNX Runtime says that the parts do NOT compute what the whole does");
  } else {
    split.lines.push_back(
        "NOT CHECKED that the parts compute what the whole does: ONNX Runtime did not run the "
        "whole" +
        (ended ? " (" + ended->to_string() + ")" : std::string()));
  }
}

Json to_json(const Split& split) {
  Json parts = Json::array();
  for (std::size_t p = 0; p < split.parts.size(); ++p)
    parts.push_back({{"file", split.files[p]},
                     {"xnode", split.app.app.xnodes[p].name},
                     {"nodes", static_cast<std::int64_t>(split.parts[p].nodes.size())},
                     {"inputs", Json(split.parts[p].inputs)},
                     {"outputs", Json(split.parts[p].outputs)}});
  return {{"schema", "xauto.split"},
          {"version", 1},
          {"parts", std::move(parts)},
          {"lines", Json(split.lines)}};
}

void print(const Split& split, const OnnxNet& net) {
  for (const std::string& line : split.lines) std::cout << wrapped("  " + line, 4) << "\n";
  for (std::size_t p = 0; p < split.parts.size(); ++p) {
    std::string times;
    for (const auto& [type, us] : split.app.app.xnodes[p].typical_us)
      times += fmt::format(", {} us on {}", us, type);
    std::cout << wrapped(fmt::format("  {}: {} nodes{}", split.files[p],
                                     split.parts[p].nodes.size(), times),
                         4)
              << "\n";
    if (p < split.at.size())
      std::cout << wrapped("    cut " + text_of(split.at[p], net), 6) << "\n";
  }
  std::cout << "\nTODO: what app.json does not know\n";
  for (const Todo& todo : split.app.todo)
    std::cout << wrapped("  - " + todo.what + (todo.at.empty() ? "" : " (" + todo.at + ")"), 4)
              << "\n";
}

Result<std::string> read_net(const std::string& path) {
  const UniqueFd fd(open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  if (!fd) return fail(ErrorCode::kNotFound, "cannot be opened", path, "name an ONNX model");
  return read_open_file(fd.get(), path, import::kMaxOnnxBytes);
}

Result<int> split_net(const SplitFlags& flags, const Options& options) {
  if (flags.at.empty() || flags.out.empty())
    return fail(ErrorCode::kInvalid, "needs to know where to cut, and where parts go",
                "xauto split", "--at 3 --out parts");
  Split split;
  XAUTO_ASSIGN(const std::string bytes, read_net(flags.net));
  XAUTO_ASSIGN(const OnnxNet net, OnnxNet::parse(bytes, flags.net));
  XAUTO_ASSIGN(split.times, read_times(flags, net, split.lines));
  XAUTO_ASSIGN(split.at, choose(flags, net, split.times, split.lines));
  if (!flags.policy.empty()) {
    XAUTO_ASSIGN(split.at, join(flags, split.at, split.lines));
  }
  split.parts = net.parts(split.at);
  XAUTO_ASSIGN(
      split.app,
      parse_imported(to_json(import::app_of_parts(name_of(flags), net.nodes().size(), split.at,
                                                  split.times, flags.margin_pct)),
                     "the parts"));
  std::error_code error;
  fs::create_directories(flags.out, error);
  if (error) return fail(ErrorCode::kIo, error.message(), flags.out, "name another folder");
  XAUTO_TRY(copy_external(net, flags));
  Outputs outputs;
  for (std::size_t p = 0; p < split.parts.size(); ++p) {
    split.files.push_back(
        (fs::path(flags.out) / (name_of(flags) + "." + std::to_string(p + 1) + ".onnx")).string());
    if (fs::equivalent(split.files.back(), flags.net, error))
      return fail(ErrorCode::kInvalid, "is the net itself", split.files.back(),
                  "name another folder");
    outputs.write(split.files.back(), split.parts[p].model);
  }
  outputs.write((fs::path(flags.out) / "app.json").string(), to_json(split.app));
  if (outputs.good()) check_equal(flags, split);
  if (options.json)
    std::cout << to_json(split).dump(2) << "\n";
  else
    print(split, net);
  return outputs.status(split.equal ? kDone : kAnswerIsNo);
}

}  // namespace

void add_split(Commands& commands) {
  auto flags = std::make_shared<SplitFlags>();
  Verb verb = commands.add(
      "split",
      "Cut an ONNX model into parts, each an XNode, so that a net may run on several XPUs.",
      "xauto split net.onnx --at 3 --out parts",
      [flags](const Options& options) { return split_net(*flags, options); });
  verb.option("net", flags->net, "ONNX model").required();
  verb.option("--at", flags->at,
              "so many cuts, or the name of the tensor that one is behind; several: names");
  verb.option("--tensors", flags->tensors, "so many may cross a cut")
      .range<std::int64_t>(1, 64)
      .shown();
  verb.option("--layers", flags->layers,
              "TYPE=FILE: what trtexec --exportProfile says of the whole net on this type of XPU; "
              "cuts are between its layers");
  verb.option("--policy", flags->policy,
              "what `solve` made of the parts: neighbours on one XPU are one part");
  verb.option("--margin-pct", flags->margin_pct, "WCET = sum of averages + this much")
      .range(0, 1000)
      .shown();
  verb.option("--name", flags->name, "of the net").shown_as("the file's");
  verb.option("--out", flags->out, "folder for the parts and app.json");
}

}  // namespace xauto::cli
