// SPDX-License-Identifier: Apache-2.0
// XModule: an ordered chain of XNodes with shared state, fired by its input topics.
#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>

#include <xauto/rate.h>
#include <xauto/topic.h>
#include <xauto/xnode.h>

namespace xauto {

namespace testing {
class Fire;
}

namespace detail {

struct XModuleSpec;
inline constexpr int kMostInFlight = 64;
/// Takes the message out of the state; made in `memory` if it is not null.
using Take = std::function<std::shared_ptr<const void>(void* state, MessageMemory* memory)>;

std::shared_ptr<XModuleSpec> make_xmodule(std::string name,
                                          std::function<std::shared_ptr<void>()> make_state);
const std::string& name_of(const XModuleSpec& module);
void add_node(XModuleSpec& module, std::shared_ptr<XNodeSpecErased> node);
void add_input(XModuleSpec& module, TopicHandle topic);
void add_sample(XModuleSpec& module, TopicHandle topic, std::chrono::nanoseconds max_age);
void add_output(XModuleSpec& module, TopicHandle topic, Take take);
void add_parameter(XModuleSpec& module, ParameterHandle parameter);
void set_in_flight(XModuleSpec& module, int activations);
void set_optional(XModuleSpec& module);
/// `late`: beyond the key of the module's last XNode.
using OnMiss = std::function<void(std::uint64_t sequence, std::chrono::nanoseconds late)>;
void set_on_miss(XModuleSpec& module, OnMiss callback);
using UrgentIf = std::function<bool(const void* state)>;
void set_urgent_if(XModuleSpec& module, UrgentIf judge);
void set_timer(XModuleSpec& module, std::chrono::microseconds period);
void set_timer(XModuleSpec& module, Rate rate);

}  // namespace detail

/// A module of an application: its XNodes run one after the other on the module's `State`, each on
/// the XPU instance that the policy gives it. It fires when every input topic has a message newer
/// than the last one it used; sampled topics have no say in it. One activation is in flight at a time
/// unless `in_flight` says otherwise; a message that arrives meanwhile waits, and a newer one
/// replaces it (counted as dropped).
///
/// A handle: copies name the same module. `State` must be default-constructible, or a factory is
/// given.
template <class State>
class XModule {
 public:
  /// `name` must be unique in the app. The state is made by `State()`, once per run for each
  /// activation that may be in flight.
  explicit XModule(std::string name)
      : XModule(std::move(name), [] { return std::make_shared<State>(); }) {}
  /// The same with a factory, for a State that is not default-constructible. It must not return
  /// null; what it throws ends the run.
  XModule(std::string name, std::function<std::shared_ptr<State>()> make_state)
      : spec_(detail::make_xmodule(
            std::move(name),
            [make = std::move(make_state)]() -> std::shared_ptr<void> { return make(); })) {}

  /// Appends `node` to the chain. One that is in it already is reported by App::check().
  XModule& add_node(const XNode<State>& node) {
    detail::add_node(*spec_, node.spec_);
    return *this;
  }

  /// The module fires when each of its input topics has a new message. At least one is needed.
  template <class T>
  XModule& add_input_topic(const Topic<T>& topic) {
    detail::add_input(*spec_, detail::topic_spec(topic));
    return *this;
  }

  /// The same by its name alone: what it carries is known from a Topic of that name elsewhere in the app, its source's or
  /// its publisher's. If there is none, App::check() says so. Input::get<T>("name") reads it.
  XModule& add_input_topic(const std::string& name) {
    detail::add_input(*spec_, detail::make_topic(name));
    return *this;
  }

  /// The module's XNodes may look at the newest message of this topic (Input::sampled). It fires
  /// nobody, and nobody waits for it: so modules of different rates meet, and cycles are possible.
  /// It is read when the first XNode of an activation starts. One that is older than `max_age`
  /// then (Input::age) is not shown; 0: whatever its age.
  template <class T>
  XModule& add_sampled_topic(const Topic<T>& topic, std::chrono::nanoseconds max_age = {}) {
    detail::add_sample(*spec_, detail::topic_spec(topic), max_age);
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
    detail::add_output(
        *spec_, detail::topic_spec(topic),
        [make = std::move(make)](
            void* state, detail::MessageMemory* memory) mutable -> std::shared_ptr<const void> {
          State& from = *static_cast<State*>(state);
          if constexpr (std::is_convertible_v<std::invoke_result_t<Make, State&>,
                                              std::shared_ptr<const T>>)
            return std::shared_ptr<const T>(make(from));
          else
            return detail::make_message<T>(memory, [&]() -> T { return make(from); });
        });
    return *this;
  }

  /// The module's XNodes may read this parameter (Input::value). Declared twice is once.
  template <class T>
  XModule& add_parameter(const Parameter<T>& parameter) {
    detail::add_parameter(*spec_, parameter.spec_);
    return *this;
  }

  /// The module fires by the clock: once per `period` (1 us to 1 h), from the start of the run on.
  /// That is a source of the app, "NAME/every"; app.json may give it another period, an offset and a
  /// clock. Input topics are waited for as well; sample what is not to be waited for.
  XModule& every(std::chrono::microseconds period) {
    detail::set_timer(*spec_, period);
    return *this;
  }
  /// The same at a rate: every(30_hz).
  XModule& every(Rate rate) {
    detail::set_timer(*spec_, rate);
    return *this;
  }

  /// What the module publishes is urgent where `judge(const State&)` says so, asked when its chain has ended: whoever
  /// hears of it by input topics has earlier keys. app.json states by how much, and how often that may be (`marked_by` of
  /// a source's `urgent`); the worst cases hold with it. Where it states nothing, and too soon after an urgent one, the
  /// result is an ordinary one, and the report counts that. What it throws loses the activation.
  XModule& urgent_if(std::function<bool(const State&)> judge) {
    detail::set_urgent_if(*spec_, [judge = std::move(judge)](const void* state) {
      return judge(*static_cast<const State*>(state));
    });
    return *this;
  }

  /// Calls `callback(sequence, late)` when an activation has ended `late` after the key that the plan
  /// gave the module's last XNode, in a run by keys. On the thread that ran it, after the result was
  /// published: be short. What it throws is logged.
  XModule& on_miss(std::function<void(std::uint64_t, std::chrono::nanoseconds)> callback) {
    detail::set_on_miss(*spec_, std::move(callback));
    return *this;
  }

  /// The most activations that `in_flight` takes.
  static constexpr int kMostInFlight = detail::kMostInFlight;
  /// Up to `activations` at once, 1 to kMostInFlight: the next one starts while earlier ones are
  /// under way. Each has a State of its own, and an `init` of each XNode on the XPU that it runs on.
  /// So nothing in State may be carried from one activation to the next. Each XNode takes activations
  /// in order, and results leave in order. A plan may allow fewer (app.json's
  /// `max_in_flight`).
  XModule& in_flight(int activations) {
    detail::set_in_flight(*spec_, activations);
    return *this;
  }

  /// The app can do without it: where a set of tables says so, in scenarios that its user marks as
  /// degraded, it gets no release. Modules that wait for one of its outputs have to be optional, too.
  XModule& optional() {
    detail::set_optional(*spec_);
    return *this;
  }

  /// As given.
  [[nodiscard]] const std::string& name() const { return detail::name_of(*spec_); }

 private:
  friend class App;
  friend class testing::Fire;
  std::shared_ptr<detail::XModuleSpec> spec_;
};

}  // namespace xauto
