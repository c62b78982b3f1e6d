// SPDX-License-Identifier: Apache-2.0
// An ONNX model, cut into parts that are models.
//
// What a net computes from its inputs alone counts: its *live* nodes, in the file's order, which is a topological one.
// Nodes that need no input (constants, and what is computed of initializers alone) go to each part that uses them, like
// initializers. A *cut* is a place between two live nodes. A tensor *crosses* it if a node before makes it and a node
// behind uses it. Inputs of the net go to every part that uses them, outputs leave the part that makes them: neither
// crosses.
//
// Theorem. Let every live node lie on a way from an input to an output, and let t be a tensor through which every way from
// an input to an output goes, made by node p, which is not the last. Then the place behind p is a cut that t alone
// crosses, in whatever order the file has its nodes.
// Proof. A node is on a way, and the way goes through t: so it is an ancestor of p, or p, or uses t or is a descendant of
// who does. Ancestors come before p, descendants behind it, in every topological order. A tensor other than t that
// crosses would be made by an ancestor and used by a descendant: a way around t. QED
//
// So what is found for one tensor does not depend on the order. For several tensors it does: those places count that the
// file's order has.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <xauto/result.h>

#include "model/imported.h"

#include "import/trtexec.h"

namespace xauto::import {

inline constexpr std::size_t kMaxOnnxBytes = 2'000'000'000;  ///< protobuf has no more
inline constexpr std::size_t kMaxOnnxNodes = 500'000, kMaxParts = 65;

/// A place behind `after` live nodes.
struct OnnxCut {
  std::size_t after = 0;
  std::vector<std::string> tensors;  ///< that cross, in the order of their making
  std::int64_t bytes = -1;           ///< of all of them; -1: not all shapes are known
};

struct OnnxPart {
  std::vector<std::string> nodes;            ///< live ones, by name or else "op 3"
  std::vector<std::string> inputs, outputs;  ///< tensors
  std::string model;                         ///< the file's bytes
};

class OnnxNet {
 public:
  /// Errors: no ONNX model; a node that uses what nothing before it makes (a circle, a tensor that is missing, an order
  /// that is none); a tensor that is made twice; an output that nothing makes.
  [[nodiscard]] static Result<OnnxNet> parse(std::string_view bytes, const std::string& origin);

  [[nodiscard]] const std::vector<std::string>& nodes() const;  ///< live ones
  /// At which at most so many tensors cross, all of known type; ascending.
  [[nodiscard]] const std::vector<OnnxCut>& cuts() const;
  [[nodiscard]] std::vector<OnnxCut> cuts(std::size_t most_tensors) const;
  /// Cuts that are left out since the type of a tensor is not stated, and does not follow from the others'.
  [[nodiscard]] std::size_t untyped() const;
  /// The cut behind which `tensor` is first there; none: it is made by no live node, or the last one.
  [[nodiscard]] const OnnxCut* cut_behind(const std::string& tensor) const;
  /// Files beside it that hold tensors. Errors: one that is not below its folder.
  [[nodiscard]] Result<std::vector<std::string>> external_files() const;

  /// Parts between these cuts, ascending. All tensors that cross have types.
  [[nodiscard]] std::vector<OnnxPart> parts(const std::vector<OnnxCut>& at) const;

  OnnxNet(OnnxNet&&) noexcept;
  OnnxNet& operator=(OnnxNet&&) noexcept;
  ~OnnxNet();

 private:
  struct Data;
  explicit OnnxNet(std::unique_ptr<Data> data);
  std::unique_ptr<Data> data_;
};

/// What each live node takes, in us, where a layer names nodes ("conv1 + relu1"): all of it at the last of them. What
/// names none goes to the one before. `fused`: [node] whether a layer goes on behind it, so that no cut is there.
struct LayerTimes {
  std::string type;        ///< of XPU
  std::vector<double> us;  ///< [live node]
  std::vector<bool> fused;
  double unnamed = 0;  ///< part of the time of layers that name no node, 0 to 1
};

/// Errors: no layer names a node.
[[nodiscard]] Result<LayerTimes> times_of_nodes(const OnnxNet& net, const std::string& type,
                                                const std::vector<EngineLayer>& layers,
                                                const std::string& origin);

/// `count` of the cuts, so that the part is shortest that takes longest: of the sum over all `times`, each as a part of
/// its whole; without times by the number of nodes. All of them where there are no more.
[[nodiscard]] std::vector<OnnxCut> even_cuts(const OnnxNet& net, const std::vector<OnnxCut>& cuts,
                                             const std::vector<LayerTimes>& times,
                                             std::size_t count);

/// An app of one module whose XNodes are the parts, `name`.1 and so on; parts without times have TODOs for them.
[[nodiscard]] ImportedApp app_of_parts(const std::string& name, std::size_t nodes,
                                       const std::vector<OnnxCut>& at,
                                       const std::vector<LayerTimes>& times,
                                       std::int64_t margin_pct);

}  // namespace xauto::import
