// SPDX-License-Identifier: Apache-2.0
#include "import/onnx_net.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <map>
#include <optional>
#include <set>
#include <unordered_map>
#include <unordered_set>
#include <utility>

#include "base/index.h"

#include "import/onnx.pb.h"
#include "import/questions.h"

namespace xauto::import {
namespace {

namespace pb = onnx_file;
using Names = std::unordered_set<std::string>;

constexpr int kMaxGraphDepth = 16;  ///< of If, Loop and Scan
constexpr int kExternal = 1;        ///< TensorProto.DataLocation
// TensorProto.DataType
constexpr int kFloat = 1, kUint8 = 2, kInt64 = 7, kBool = 9;

/// Operators whose first output has the type of the first input.
constexpr std::string_view kSameType =
    " Abs Add AveragePool BatchNormalization Ceil Clip Concat Conv ConvTranspose DepthToSpace"
    " Div Dropout Elu Erf Exp Expand Flatten Floor Gather GatherElements GatherND Gelu Gemm"
    " GlobalAveragePool GlobalMaxPool HardSigmoid HardSwish Identity InstanceNormalization"
    " LayerNormalization LeakyRelu Log LogSoftmax LRN MatMul Max MaxPool Mean Min Mish Mul Neg"
    " PRelu Pad Pow ReduceMax ReduceMean ReduceMin ReduceSum Relu Reshape Resize Round"
    " ScatterND Selu Sigmoid Slice Softmax Softplus SpaceToDepth Split Sqrt Squeeze Sub Sum"
    " Tanh Tile Transpose Unsqueeze Upsample ";

bool is_one_of(std::string_view op, std::initializer_list<std::string_view> ops) {
  return std::ranges::find(ops, op) != ops.end();
}

/// What `graph` uses and does not make itself: of the graph around it. False: nested too deep.
bool captured(const pb::Graph& graph, Names& into, int depth) {
  if (depth > kMaxGraphDepth) return false;
  Names made;
  for (const auto& input : graph.input()) made.insert(input.name());
  for (const auto& tensor : graph.initializer()) made.insert(tensor.name());
  for (const auto& tensor : graph.sparse_initializer()) made.insert(tensor.values().name());
  const auto use = [&](const std::string& name) {
    if (!name.empty() && !made.contains(name)) into.insert(name);
  };
  for (const auto& node : graph.node()) {
    for (const std::string& name : node.input()) use(name);
    for (const auto& attribute : node.attribute()) {
      Names inner;
      if (attribute.has_g() && !captured(attribute.g(), inner, depth + 1)) return false;
      for (const auto& g : attribute.graphs())
        if (!captured(g, inner, depth + 1)) return false;
      for (const std::string& name : inner) use(name);
    }
    for (const std::string& name : node.output()) made.insert(name);
  }
  for (const auto& output : graph.output()) use(output.name());
  return true;
}

/// Of how many bytes an element is; 0: of no fixed number.
std::int64_t bytes_of(int type) {
  constexpr std::array<std::int64_t, 17> kBytes = {0, 4, 1, 1, 2, 2, 4,  8, 0,
                                                   1, 2, 8, 4, 8, 8, 16, 2};
  return type > 0 && type < static_cast<int>(kBytes.size()) ? kBytes[at(type)] : 0;
}

struct LiveNode {
  int node = -1;                  ///< index into Graph::node
  std::vector<std::string> uses;  ///< live tensors and inputs of the net, each once
  std::vector<std::string> makes;
};

}  // namespace

struct OnnxNet::Data {
  std::string origin;
  pb::Model model;  ///< without its graph
  pb::Graph graph;
  std::vector<LiveNode> live;
  std::vector<std::string> names;  ///< [live node]
  std::vector<OnnxCut> cuts;       ///< all of known types
  std::size_t untyped = 0;
  std::unordered_map<std::string, int> types;  ///< TensorProto.DataType, where known
  std::unordered_map<std::string, const pb::ValueInfo*> stated;
  std::unordered_map<std::string, std::size_t> made_by;  ///< live tensor -> live node
  std::unordered_map<std::string, int> constant_by;      ///< tensor -> node that needs no input
  std::unordered_map<std::string, int> initializers, sparse;
  Names net_inputs;                            ///< without those that initializers fill
  std::vector<std::vector<std::string>> uses;  ///< [node] all that it uses, each once

  [[nodiscard]] tl::unexpected<Error> broken(const std::string& what) const {
    return fail(ErrorCode::kInvalid, what, origin, "export it again, or name an ONNX model");
  }

  Status read() {
    XAUTO_TRY(read_names());
    XAUTO_TRY(read_nodes());
    drop_unused();
    for (const auto& output : graph.output())
      if (!made_by.contains(output.name()))
        return broken("output '" + output.name() + "' is made by no node");
    if (live.empty()) return broken("has no node that computes anything from its inputs");
    infer_types();
    find_cuts();
    return {};
  }

  Status read_names() {
    for (int i = 0; i < graph.initializer_size(); ++i)
      if (!initializers.try_emplace(graph.initializer(i).name(), i).second)
        return broken("initializer '" + graph.initializer(i).name() + "' is there twice");
    for (int i = 0; i < graph.sparse_initializer_size(); ++i)
      sparse.try_emplace(graph.sparse_initializer(i).values().name(), i);
    for (const auto& input : graph.input())
      if (!initializers.contains(input.name()) && !sparse.contains(input.name()))
        net_inputs.insert(input.name());
    for (const auto* list : {&graph.value_info(), &graph.input(), &graph.output()})
      for (const auto& info : *list) stated[info.name()] = &info;
    return {};
  }

  [[nodiscard]] bool fixed(const std::string& name) const {
    return initializers.contains(name) || sparse.contains(name) || constant_by.contains(name);
  }

  Status read_nodes() {
    Names outputs;
    for (const auto& output : graph.output()) outputs.insert(output.name());
    for (int n = 0; n < graph.node_size(); ++n) {
      const pb::Node& node = graph.node(n);
      const std::string what = "node " + std::to_string(n) + " (" + node.op_type() + ")";
      Names all(node.input().begin(), node.input().end());
      bool nested = false;
      for (const auto& attribute : node.attribute()) {
        nested = nested || attribute.has_g() || attribute.graphs_size() > 0;
        bool read = !attribute.has_g() || captured(attribute.g(), all, 0);
        for (const auto& g : attribute.graphs()) read = read && captured(g, all, 0);
        if (!read) return broken(what + " has graphs that are nested too deep");
      }
      all.erase("");
      LiveNode one{n, {}, {}};
      bool is_fixed = !nested && !is_random(node);
      for (const std::string& name : all) {
        if (fixed(name)) continue;
        if (!net_inputs.contains(name) && !made_by.contains(name))
          return broken(what + " uses '" + name + "', which nothing before it makes");
        is_fixed = false;
        one.uses.push_back(name);
      }
      std::ranges::sort(one.uses);
      uses.emplace_back(all.begin(), all.end());
      for (const std::string& name : node.output()) {
        if (name.empty()) continue;
        if (fixed(name) || net_inputs.contains(name) || made_by.contains(name))
          return broken(what + " makes '" + name + "', which is there already");
        is_fixed = is_fixed && !outputs.contains(name);
        one.makes.push_back(name);
      }
      if (Names(one.makes.begin(), one.makes.end()).size() != one.makes.size())
        return broken(what + " makes a tensor twice");
      if (is_fixed) {
        for (const std::string& name : one.makes) constant_by[name] = n;
        continue;
      }
      for (const std::string& name : one.makes) made_by[name] = live.size();
      names.push_back(node.name().empty() || !fault_of_name(node.name()).empty() ? what
                                                                                 : node.name());
      live.push_back(std::move(one));
    }
    return {};
  }

  /// What no output needs: a part of it alone would have no output.
  void drop_unused() {
    Names needed;
    for (const auto& output : graph.output()) needed.insert(output.name());
    std::vector<bool> keep(live.size(), false);
    for (std::size_t n = live.size(); n-- > 0;) {
      keep[n] = std::ranges::any_of(live[n].makes,
                                    [&](const std::string& name) { return needed.contains(name); });
      if (keep[n]) needed.insert(live[n].uses.begin(), live[n].uses.end());
    }
    std::vector<LiveNode> kept;
    std::vector<std::string> kept_names;
    for (std::size_t n = 0; n < live.size(); ++n) {
      for (const std::string& name : live[n].makes)
        if (keep[n])
          made_by[name] = kept.size();
        else
          made_by.erase(name);
      if (!keep[n]) continue;
      kept.push_back(std::move(live[n]));
      kept_names.push_back(std::move(names[n]));
    }
    live = std::move(kept);
    names = std::move(kept_names);
  }

  static bool is_random(const pb::Node& node) {
    return node.op_type().starts_with("Random") ||
           is_one_of(node.op_type(), {"Bernoulli", "Multinomial"}) ||
           !is_one_of(node.domain(), {"", "ai.onnx"});
  }

  // ---- types ------------------------------------------------------------------------------------------

  void infer_types() {
    for (const auto& [name, info] : stated)
      if (info->type().tensor_type().elem_type() != 0)
        types[name] = info->type().tensor_type().elem_type();
    for (const auto& tensor : graph.initializer()) types[tensor.name()] = tensor.data_type();
    for (const auto& node : graph.node()) {
      for (int o = 0; o < node.output_size(); ++o)
        if (!node.output(o).empty() && !types.contains(node.output(o)))
          if (const auto type = type_of(node, o)) types[node.output(o)] = *type;
    }
  }

  [[nodiscard]] std::optional<int> type_of_input(const pb::Node& node, int index) const {
    if (index >= node.input_size()) return std::nullopt;
    const auto found = types.find(node.input(index));
    return found == types.end() ? std::nullopt : std::optional(found->second);
  }

  /// Where it follows from the operator alone.
  [[nodiscard]] std::optional<int> type_of(const pb::Node& node, int output) const {
    const std::string& op = node.op_type();
    if (!is_one_of(node.domain(), {"", "ai.onnx"})) return std::nullopt;
    const auto attribute = [&](const char* name) -> const pb::Attribute* {
      for (const auto& one : node.attribute())
        if (one.name() == name) return &one;
      return nullptr;
    };
    if (op == "Cast") {
      const auto* to = attribute("to");
      return to == nullptr ? std::nullopt : std::optional(static_cast<int>(to->i()));
    }
    if (op == "Constant" || op == "ConstantOfShape") {
      const auto* value = attribute("value");
      if (value != nullptr) return value->t().data_type();
      return op == "ConstantOfShape" ? std::optional(kFloat) : std::nullopt;
    }
    if (is_one_of(op, {"Shape", "Size", "ArgMax", "ArgMin", "NonZero"})) return kInt64;
    if (op == "TopK" && output == 1) return kInt64;
    if (is_one_of(op, {"Equal", "Greater", "Less", "GreaterOrEqual", "LessOrEqual", "And", "Or",
                       "Not", "Xor", "IsNaN", "IsInf"}))
      return kBool;
    if (op == "QuantizeLinear")
      return node.input_size() > 2 ? type_of_input(node, 2) : std::optional(kUint8);
    if (op == "DequantizeLinear") return type_of_input(node, 1);
    if (op == "Where") return type_of_input(node, 1);
    if (output == 0 && kSameType.find(" " + op + " ") != std::string_view::npos)
      return type_of_input(node, 0);
    return op == "Split" ? type_of_input(node, 0) : std::nullopt;
  }

  // ---- cuts -------------------------------------------------------------------------------------------

  void find_cuts() {
    std::unordered_map<std::string, std::size_t> last;  // who uses it last
    for (std::size_t n = 0; n < live.size(); ++n)
      for (const std::string& name : live[n].uses) last[name] = n;
    std::map<std::pair<std::size_t, std::string>, bool> open;  // by who makes it
    for (std::size_t n = 0; n + 1 < live.size(); ++n) {
      for (const std::string& name : live[n].makes) {
        const auto used = last.find(name);
        if (used != last.end() && used->second > n) open[{n, name}] = types.contains(name);
      }
      for (const std::string& name : live[n].uses)
        if (last.at(name) == n && made_by.contains(name)) open.erase({made_by.at(name), name});
      if (open.size() > kMostTensors) continue;
      if (!std::ranges::all_of(open, [](const auto& one) { return one.second; })) {
        ++untyped;
        continue;
      }
      OnnxCut cut{n + 1, {}, 0};
      for (const auto& [key, typed] : open) {
        const std::int64_t bytes = size_of(key.second);
        cut.bytes = bytes < 0 || cut.bytes < 0 ? -1 : cut.bytes + bytes;
        cut.tensors.push_back(key.second);
      }
      cuts.push_back(std::move(cut));
    }
  }

  /// Bytes of a tensor; -1: its shape is not stated, or open.
  [[nodiscard]] std::int64_t size_of(const std::string& name) const {
    const auto info = stated.find(name);
    if (info == stated.end() || !info->second->type().tensor_type().has_shape()) return -1;
    double bytes = static_cast<double>(bytes_of(types.at(name)));
    for (const auto& dim : info->second->type().tensor_type().shape().dim()) {
      if (dim.dim_value() <= 0) return -1;
      bytes *= static_cast<double>(dim.dim_value());
    }
    return bytes <= 0 || bytes > 1e15 ? -1 : static_cast<std::int64_t>(bytes);
  }

  // ---- parts ------------------------------------------------------------------------------------------

  static constexpr std::size_t kMostTensors = 64;

  [[nodiscard]] pb::ValueInfo info_of(const std::string& name) const {
    const auto info = stated.find(name);
    if (info != stated.end() && info->second->has_type()) return *info->second;
    pb::ValueInfo made;
    made.set_name(name);
    if (const auto type = types.find(name); type != types.end())
      made.mutable_type()->mutable_tensor_type()->set_elem_type(type->second);
    return made;
  }

  /// The nodes that need no input, and that these names need, with what those need.
  void add_fixed(const std::string& name, std::set<int>& nodes) const {
    std::vector<std::string> wanted = {name};
    while (!wanted.empty()) {
      const auto by = constant_by.find(wanted.back());
      wanted.pop_back();
      if (by == constant_by.end() || !nodes.insert(by->second).second) continue;
      for (const std::string& need : uses[at(by->second)]) wanted.push_back(need);
    }
  }

  OnnxPart part(std::size_t from, std::size_t to, const Names& used_later,
                std::size_t number) const {
    OnnxPart made;
    std::set<int> nodes;
    Names needs, makes;
    for (std::size_t n = from; n < to; ++n) {
      nodes.insert(live[n].node);
      made.nodes.push_back(names[n]);
      for (const std::string& name : uses[at(live[n].node)]) add_fixed(name, nodes);
      makes.insert(live[n].makes.begin(), live[n].makes.end());
    }
    pb::Model file = model;
    pb::Graph& into = *file.mutable_graph();
    into.set_name(graph.name() + "." + std::to_string(number));
    for (const int n : nodes) {
      *into.add_node() = graph.node(n);
      needs.insert(uses[at(n)].begin(), uses[at(n)].end());
    }
    for (const auto& input : graph.input())
      if (needs.contains(input.name())) {
        *into.add_input() = input;
        if (net_inputs.contains(input.name())) made.inputs.push_back(input.name());
      }
    std::set<std::pair<std::size_t, std::string>> crossing;
    for (const std::string& name : needs)
      if (const auto by = made_by.find(name); by != made_by.end() && by->second < from)
        crossing.insert({by->second, name});
    for (const auto& [by, name] : crossing) {
      *into.add_input() = info_of(name);
      made.inputs.push_back(name);
    }
    Names outputs;
    const auto output = [&](const std::string& name) {
      if (!outputs.insert(name).second) return;
      *into.add_output() = info_of(name);
      made.outputs.push_back(name);
    };
    for (std::size_t n = from; n < to; ++n)
      for (const std::string& name : live[n].makes)
        if (used_later.contains(name)) output(name);
    for (const auto& one : graph.output())
      if (makes.contains(one.name())) output(one.name());
    add_fixed_tensors(needs, into);
    for (const auto& info : graph.value_info())
      if (makes.contains(info.name()) && !outputs.contains(info.name()))
        *into.add_value_info() = info;
    for (const auto& note : graph.quantization_annotation())
      if (makes.contains(note.tensor_name()) || needs.contains(note.tensor_name()))
        *into.add_quantization_annotation() = note;
    file.SerializeToString(&made.model);
    return made;
  }

  void add_fixed_tensors(const Names& needs, pb::Graph& into) const {
    for (const auto& tensor : graph.initializer())
      if (needs.contains(tensor.name())) *into.add_initializer() = tensor;
    for (const auto& tensor : graph.sparse_initializer())
      if (needs.contains(tensor.values().name())) *into.add_sparse_initializer() = tensor;
  }
};

OnnxNet::OnnxNet(std::unique_ptr<Data> data) : data_(std::move(data)) {}
OnnxNet::OnnxNet(OnnxNet&&) noexcept = default;
OnnxNet& OnnxNet::operator=(OnnxNet&&) noexcept = default;
OnnxNet::~OnnxNet() = default;

Result<OnnxNet> OnnxNet::parse(std::string_view bytes, const std::string& origin) {
  auto data = std::make_unique<Data>();
  data->origin = origin;
  if (bytes.size() > kMaxOnnxBytes)
    return data->broken(
        "is larger than 2 GB; models of that size keep their tensors in another file");
  if (!data->model.ParseFromArray(bytes.data(), static_cast<int>(bytes.size())) ||
      !data->model.has_graph() || data->model.graph().node_size() == 0)
    return data->broken("is no ONNX model with nodes");
  data->graph.Swap(data->model.mutable_graph());
  data->model.clear_graph();
  data->model.clear_training_info();  // of the whole net: no part could be trained by it
  if (static_cast<std::size_t>(data->graph.node_size()) > kMaxOnnxNodes)
    return data->broken("has more than 500000 nodes");
  XAUTO_TRY(data->read());
  return OnnxNet(std::move(data));
}

const std::vector<std::string>& OnnxNet::nodes() const {
  return data_->names;
}

const std::vector<OnnxCut>& OnnxNet::cuts() const {
  return data_->cuts;
}

std::vector<OnnxCut> OnnxNet::cuts(std::size_t most_tensors) const {
  std::vector<OnnxCut> few;
  for (const OnnxCut& cut : data_->cuts)
    if (cut.tensors.size() <= most_tensors) few.push_back(cut);
  return few;
}

std::size_t OnnxNet::untyped() const {
  return data_->untyped;
}

const OnnxCut* OnnxNet::cut_behind(const std::string& tensor) const {
  const auto by = data_->made_by.find(tensor);
  if (by == data_->made_by.end()) return nullptr;
  const auto cut = std::ranges::find(data_->cuts, by->second + 1, &OnnxCut::after);
  return cut == data_->cuts.end() ? nullptr : &*cut;
}

Result<std::vector<std::string>> OnnxNet::external_files() const {
  std::set<std::string> files;
  for (const auto& tensor : data_->graph.initializer()) {
    if (tensor.data_location() != kExternal) continue;
    for (const auto& entry : tensor.external_data()) {
      if (entry.key() != "location") continue;
      const std::filesystem::path path(entry.value());
      const bool below = !entry.value().empty() && path.is_relative() &&
                         std::ranges::none_of(path, [](const auto& p) { return p == ".."; });
      if (!below || entry.value().find('\0') != std::string::npos)
        return data_->broken("initializer '" + tensor.name() +
                             "' is in a file outside the model's folder");
      files.insert(entry.value());
    }
  }
  return std::vector<std::string>(files.begin(), files.end());
}

std::vector<OnnxPart> OnnxNet::parts(const std::vector<OnnxCut>& cuts) const {
  const Data& data = *data_;
  std::vector<std::size_t> ends;
  for (const OnnxCut& cut : cuts) ends.push_back(cut.after);
  ends.push_back(data.live.size());
  std::vector<OnnxPart> made;
  Names used_later;
  // From the last one on: what is used later is known then.
  for (std::size_t p = ends.size(); p-- > 0;) {
    const std::size_t from = p == 0 ? 0 : ends[p - 1];
    made.push_back(data.part(from, ends[p], used_later, p + 1));
    for (std::size_t n = from; n < ends[p]; ++n)
      used_later.insert(data.live[n].uses.begin(), data.live[n].uses.end());
  }
  std::ranges::reverse(made);
  return made;
}

// ---- times ----------------------------------------------------------------------------------------------

Result<LayerTimes> times_of_nodes(const OnnxNet& net, const std::string& type,
                                  const std::vector<EngineLayer>& layers,
                                  const std::string& origin) {
  LayerTimes made{type, std::vector<double>(net.nodes().size(), 0),
                  std::vector<bool>(net.nodes().size(), false), 0};
  std::unordered_map<std::string_view, std::size_t> index;
  for (std::size_t n = 0; n < net.nodes().size(); ++n) index.try_emplace(net.nodes()[n], n);
  double all = 0, unnamed = 0, before_any = 0;
  std::optional<std::size_t> last;
  for (const EngineLayer& layer : layers) {
    // Node names are what is between these; a name itself has none of them.
    constexpr std::string_view kBetween = " +,()[]{}|";
    std::optional<std::size_t> first_named, last_named;
    const auto look = [&](std::string_view word) {
      while (word.ends_with("...")) word.remove_suffix(3);
      while (word.starts_with("...")) word.remove_prefix(3);
      const auto found = index.find(word);
      if (found == index.end()) return;
      first_named = std::min(first_named.value_or(found->second), found->second);
      last_named = std::max(last_named.value_or(found->second), found->second);
    };
    std::string_view rest = layer.name;
    look(rest);
    // A reformatting names the layer that it is for, and is none of its nodes.
    const bool copy = rest.starts_with("Reformatting");
    while (!copy && !rest.empty()) {
      const std::size_t end = std::min(rest.find_first_of(kBetween), rest.size());
      std::string_view word = rest.substr(0, end);
      if (const std::size_t dots = word.find("..."); dots != std::string_view::npos) {
        look(word.substr(0, dots));
        look(word.substr(dots));
      } else {
        look(word);
      }
      rest.remove_prefix(std::min(end + 1, rest.size()));
    }
    all += layer.average_us;
    if (last_named) {
      last = std::max(last.value_or(0), *last_named);
      made.us[*last_named] += layer.average_us + std::exchange(before_any, 0);
      for (std::size_t n = *first_named; n < *last_named; ++n) made.fused[n] = true;
    } else {
      unnamed += layer.average_us;
      (last ? made.us[*last] : before_any) += layer.average_us;
    }
  }
  if (!last)
    return fail(ErrorCode::kInvalid, "no layer in it names a node of the net", origin,
                "profile an engine that was built from this very .onnx file");
  made.unnamed = all > 0 ? unnamed / all : 0;
  return made;
}

namespace {

std::vector<double> weights(const OnnxNet& net, const std::vector<LayerTimes>& times) {
  std::vector<double> weight(net.nodes().size(), times.empty() ? 1 : 0);
  for (const LayerTimes& one : times) {
    double all = 0;
    for (const double us : one.us) all += us;
    for (std::size_t n = 0; n < weight.size() && all > 0; ++n) weight[n] += one.us[n] / all;
  }
  return weight;
}

}  // namespace

std::vector<OnnxCut> even_cuts(const OnnxNet& net, const std::vector<OnnxCut>& cuts,
                               const std::vector<LayerTimes>& times, std::size_t count) {
  if (cuts.size() <= count) return cuts;
  const std::vector<double> weight = weights(net, times);
  std::vector<double> until = {0};  // [cut] weight before it
  double sum = 0;
  std::size_t n = 0;
  for (const OnnxCut& cut : cuts) {
    for (; n < cut.after; ++n) sum += weight[n];
    until.push_back(sum);
  }
  for (; n < weight.size(); ++n) sum += weight[n];
  // The least longest part, by bisection over what fits: parts are filled as far as it goes.
  const auto fill = [&](double most) {
    std::vector<std::size_t> chosen;
    double begin = 0;
    for (std::size_t c = 1; c <= cuts.size(); ++c) {
      const double next = c < cuts.size() ? until[c + 1] : sum;
      if (next - begin > most) {
        chosen.push_back(c - 1);
        begin = until[c];
      }
    }
    return chosen;
  };
  double low = 0, high = sum;
  const auto longest = [&](const std::vector<std::size_t>& chosen) {
    double begin = 0, most = 0;
    for (const std::size_t c : chosen) {
      most = std::max(most, until[c + 1] - begin);
      begin = until[c + 1];
    }
    return std::max(most, sum - begin);
  };
  for (int step = 0; step < 60; ++step) {
    const double middle = (low + high) / 2;
    const std::vector<std::size_t> chosen = fill(middle);
    const bool fits = chosen.size() <= count && longest(chosen) <= middle;
    (fits ? high : low) = middle;
  }
  std::vector<OnnxCut> made;
  for (const std::size_t c : fill(high)) made.push_back(cuts[c]);
  // Fewer than asked for may be as even: the others halve what takes longest.
  std::vector<bool> taken(cuts.size(), false);
  for (const OnnxCut& cut : made)
    taken[static_cast<std::size_t>(std::ranges::find(cuts, cut.after, &OnnxCut::after) -
                                   cuts.begin())] = true;
  while (made.size() < count) {
    double begin = 0, best = -1;
    std::size_t choice = 0;
    for (std::size_t first = 0; first < cuts.size();) {
      std::size_t end = first;
      while (end < cuts.size() && !taken[end]) ++end;
      const double to = end < cuts.size() ? until[end + 1] : sum;
      for (std::size_t c = first; c < end; ++c)
        if (to - begin > best) {
          // The cut of this part that leaves the shorter longest half.
          std::size_t middle = first;
          for (std::size_t m = first; m < end; ++m)
            if (std::max(until[m + 1] - begin, to - until[m + 1]) <
                std::max(until[middle + 1] - begin, to - until[middle + 1]))
              middle = m;
          best = to - begin;
          choice = middle;
        }
      begin = to;
      first = end + 1;
    }
    taken[choice] = true;
    made.push_back(cuts[choice]);
  }
  std::ranges::sort(made, {}, &OnnxCut::after);
  return made;
}

ImportedApp app_of_parts(const std::string& name, std::size_t nodes,
                         const std::vector<OnnxCut>& at_cuts, const std::vector<LayerTimes>& times,
                         std::int64_t margin_pct) {
  ImportedApp made;
  made.app.name = name;
  made.app.one_at_a_time = true;
  made.app.sources.push_back({"input", kNoRate});
  made.app.modules.push_back({name});
  for (std::size_t p = 0; p <= at_cuts.size(); ++p) {
    const std::size_t from = p == 0 ? 0 : at_cuts[p - 1].after;
    const std::size_t to = p == at_cuts.size() ? nodes : at_cuts[p].after;
    XNodeSpec xnode{name + "." + std::to_string(p + 1), name, {}};
    if (p == 0) xnode.sources = {0};
    for (const LayerTimes& one : times) {
      double us = 0;
      for (std::size_t n = from; n < to; ++n) us += one.us[n];
      const auto whole = std::max<std::int64_t>(
          1, static_cast<std::int64_t>(std::min(std::ceil(us), static_cast<double>(kMaxTimeUs))));
      xnode.wcet_us[one.type] = with_margin(whole, margin_pct);
      xnode.typical_us[one.type] = whole;
    }
    if (times.empty()) {
      xnode.wcet_us["gpu"] = 1;
      todo(made, "/xnodes/" + std::to_string(p) + "/wcet_us",
           "how long does '" + xnode.name +
               R"(' take on each XPU? {"gpu": MICROSECONDS, "dla": MICROSECONDS})");
    }
    if (p > 0) made.app.edges.emplace_back(static_cast<int>(p) - 1, static_cast<int>(p));
    made.app.xnodes.push_back(std::move(xnode));
  }
  if (!times.empty())
    todo(made, "",
         "WCETs are sums of the layers' average times inside the whole engine: time each part by "
         "itself, "
         "and import that (--trtexec)");
  todo(made, "/sources/0/rate_hz", "how often does 'input' come, in Hz?");
  todo(made, "/deadline_us", "what is the deadline of the net, in us?");
  todo(made, "",
       "what does it cost to hand a tensor from one type of XPU to another? see transfer_us of "
       "edges");
  return made;
}

}  // namespace xauto::import
