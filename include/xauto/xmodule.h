// SPDX-License-Identifier: Apache-2.0
// XModule: an ordered chain of XNodes with shared state, fired by its input topics.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include <xauto/topic.h>
#include <xauto/xnode.h>

namespace xauto {

namespace detail {

struct OutputSpec {
  TopicSpec topic;
  std::function<std::shared_ptr<const void>(void* state)>
      take;  ///< copies the message out of the state
  /// The same, in the memory of a topic that leaves the process; may be empty.
  std::function<std::shared_ptr<const void>(void* state, MessageMemory*)> take_in;
};

struct XModuleSpec {
  std::string name;
  std::type_index state = typeid(void);
  std::function<std::shared_ptr<void>()> make_state;
  std::vector<std::shared_ptr<XNodeSpecErased>> nodes;
  std::vector<TopicSpec> inputs;
  std::vector<OutputSpec> outputs;
  std::vector<std::string> misuse;
};

}  // namespace detail

/// A module of an application: its XNodes run one after the other on the module's `State`, each on
/// the XPU instance that the policy gives it. It fires when every input topic has a message newer
/// than the last one it used. One activation is in flight at a time; a message that arrives
/// meanwhile waits, and a newer one replaces it (counted as dropped).
///
/// A handle: copies name the same module. `State` must be default-constructible, or a factory is
/// given.
template <class State>
class XModule {
 public:
  /// `name` must be unique in the app. The state is made by `State()`, once per run.
  explicit XModule(std::string name)
      : XModule(std::move(name), [] { return std::make_shared<State>(); }) {}
  /// The same with a factory, for a State that is not default-constructible. It must not return
  /// null; what it throws ends the run.
  XModule(std::string name, std::function<std::shared_ptr<State>()> make_state)
      : spec_(std::make_shared<detail::XModuleSpec>()) {
    spec_->name = std::move(name);
    spec_->state = typeid(State);
    spec_->make_state = [make = std::move(make_state)]() -> std::shared_ptr<void> {
      return make();
    };
  }

  /// Appends `node` to the chain. One that is in it already is reported by App::check().
  XModule& add_node(const XNode<State>& node) {
    for (const auto& other : spec_->nodes)
      if (other == node.spec_ || other->name == node.spec_->name)
        spec_->misuse.push_back("XNode '" + node.name() + "' is added twice to XModule '" +
                                spec_->name + "'");
    spec_->nodes.push_back(node.spec_);
    return *this;
  }

  /// The module fires when each of its input topics has a new message. At least one is needed.
  template <class T>
  XModule& add_input_topic(const Topic<T>& topic) {
    spec_->inputs.push_back(detail::topic_spec(topic));
    return *this;
  }

  /// Publishes the member `output` of the state when the chain has ended.
  template <class T>
  XModule& add_output_topic(const Topic<T>& topic, T State::*output) {
    return add_output_topic(topic, [output](State& state) { return state.*output; });
  }
  /// Publishes what `make(State&)` returns (a T or a std::shared_ptr<const T>) when the chain has
  /// ended.
  template <class T, class Make>
  requires std::is_invocable_v<Make, State&> XModule& add_output_topic(const Topic<T>& topic,
                                                                       Make make) {
    auto take = [make = std::move(make)](void* state,
                                         MessageMemory* memory) -> std::shared_ptr<const void> {
      State& from = *static_cast<State*>(state);
      if constexpr (std::is_convertible_v<std::invoke_result_t<Make, State&>,
                                          std::shared_ptr<const T>>)
        return std::shared_ptr<const T>(make(from));
      else
        return detail::make_message<T>(memory, [&]() -> T { return make(from); });
    };
    spec_->outputs.push_back(
        {detail::topic_spec(topic), [take](void* state) { return take(state, nullptr); }, take});
    return *this;
  }

  /// As given.
  [[nodiscard]] const std::string& name() const { return spec_->name; }

 private:
  friend class App;
  std::shared_ptr<detail::XModuleSpec> spec_;
};

}  // namespace xauto
