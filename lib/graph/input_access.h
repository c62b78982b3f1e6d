// SPDX-License-Identifier: Apache-2.0
// The other side of xauto::Input: of who hands it to an XNode.
#pragma once

#include <vector>

#include "model/message.h"

namespace xauto {

class InputAccess {
 public:
  [[nodiscard]] static Input make() { return {}; }
  /// `topics`: the inputs, so many, then what is sampled.
  static void bind(Input& input, const std::vector<detail::TopicSpec>* topics, std::size_t inputs) {
    input.data_->topics = topics;
    input.data_->inputs = inputs;
    input.data_->messages.resize(topics->size());
  }
  static std::vector<detail::Envelope>& messages(Input& input) { return input.data_->messages; }
  static std::vector<detail::ParameterNow>& parameters(Input& input) {
    return input.data_->parameters;
  }
  static void stamp(Input& input, std::int64_t origin_ns, std::uint64_t sequence) {
    input.data_->origin_ns = origin_ns;
    input.data_->sequence = sequence;
  }
  // Without the call that the public ones are: the hot path asks often.
  [[nodiscard]] static std::int64_t origin_ns(const Input& input) { return input.data_->origin_ns; }
  [[nodiscard]] static std::uint64_t sequence(const Input& input) { return input.data_->sequence; }
  static void due(Input& input, std::int64_t ns, std::int64_t result_ns) {
    input.data_->due_ns = ns;
    input.data_->result_due_ns = result_ns;
  }
  static void clock(Input& input, const std::int64_t* ns) { input.data_->clock_ns = ns; }
  static void begin(Input& input, std::int64_t now_ns) { input.data_->began_ns = now_ns; }
};

}  // namespace xauto
