// SPDX-License-Identifier: Apache-2.0
// Room for one activation of a module: the state that its XNodes work on, and what it was fired
// with. A module has as many as it may have activations in flight (XModule::in_flight).
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "graph/input_access.h"
#include "model/message.h"

namespace xauto::runtime {

class ModuleRuntime;

/// Threads: what is read here, by whoever runs the activation's XNodes, while it is in flight.
class alignas(64) Activation {
 public:
  Activation(int index, std::shared_ptr<void> state, const std::vector<detail::TopicSpec>* topics,
             std::size_t inputs)
      : state_(std::move(state)), index_(index) {
    InputAccess::bind(input_, topics, inputs);
  }

  /// Which of the module's it is.
  [[nodiscard]] int index() const { return index_; }
  [[nodiscard]] void* state() { return state_.get(); }
  [[nodiscard]] const Input& input() const { return input_; }
  [[nodiscard]] std::uint64_t sequence() const { return InputAccess::sequence(input_); }
  [[nodiscard]] std::int64_t origin_ns() const { return InputAccess::origin_ns(input_); }
  /// By when its next XNode is to end; 0: nothing says.
  void set_due(std::int64_t ns, std::int64_t result_ns) { InputAccess::due(input_, ns, result_ns); }
  /// When the sensor released what input number `input` was given.
  [[nodiscard]] std::int64_t origin_of(std::size_t input) {
    return InputAccess::messages(input_)[input].origin_ns;
  }
  /// Whether that came marked urgent.
  [[nodiscard]] bool is_urgent(std::size_t input) {
    return InputAccess::messages(input_)[input].urgent;
  }
  /// By source, the oldest of what it is made from; null: see Graph::tells_origins. From
  /// ModuleRuntime::begin on.
  [[nodiscard]] const std::shared_ptr<const detail::Origins>& origins() const { return origins_; }
  /// Of a release that its sensor marked urgent.
  [[nodiscard]] bool urgent() const { return urgent_; }
  /// Of its release; 0 in a run without tables.
  [[nodiscard]] std::uint32_t table() const { return table_; }
  /// It was given up: what its XNodes still do is lost.
  [[nodiscard]] bool abandoned() const {
    return fate_.load(std::memory_order_acquire) == Fate::kAbandoned;
  }

 private:
  friend class ModuleRuntime;  // and under its mutex, but for `fate_`, `origins_`, `taken_`
  enum class Stage : std::uint8_t {
    kFree,
    kRuns,
    kSucceeded,  ///< its chain has ended; what is older has not
    kFailed,     ///< likewise
    kHung,       ///< given up; its exec has not returned
  };
  /// `finish` and `abandon` race for it.
  enum class Fate : std::uint8_t { kOpen, kEnding, kAbandoned };

  Input input_ = InputAccess::make();
  std::shared_ptr<void> state_;
  const int index_;
  Stage stage_ = Stage::kFree;
  std::atomic<Fate> fate_{Fate::kOpen};
  bool urgent_ = false;
  bool marks_ = false;   ///< what its module publishes of it is to be urgent
  bool parked_ = false;  ///< an older one is not yet through with the next XNode
  std::uint32_t table_ = 0;
  std::uint64_t number_ = 0;                        ///< how many were fired before it
  std::size_t position_ = 0;                        ///< XNodes of the chain that it is through with
  Activation* next_ = nullptr;                      ///< of those that a caller is to run
  std::vector<std::shared_ptr<const void>> taken_;  ///< its results, by output
  std::shared_ptr<const detail::Origins> origins_;
  std::uint64_t parameters_ = 0;  ///< version of those that it sees
};

}  // namespace xauto::runtime
