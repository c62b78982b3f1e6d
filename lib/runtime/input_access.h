// SPDX-License-Identifier: Apache-2.0
// The runtime's side of xauto::Input.
#pragma once

#include <vector>

#include <xauto/topic.h>

namespace xauto {

class InputAccess {
 public:
  static void bind(Input& input, const std::vector<detail::TopicSpec>* topics) {
    input.topics_ = topics;
    input.messages_.resize(topics->size());
  }
  static std::vector<detail::Envelope>& messages(Input& input) { return input.messages_; }
  static void stamp(Input& input, std::int64_t origin_ns, std::uint64_t sequence) {
    input.origin_ns_ = origin_ns;
    input.sequence_ = sequence;
  }
};

}  // namespace xauto
