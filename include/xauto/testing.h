// SPDX-License-Identifier: Apache-2.0
// For tests of an app's stages: fires one XModule on messages made by hand, in virtual time. No
// daemon, no thread, nothing but the caller's: what goes in decides what comes out.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <typeinfo>
#include <utility>
#include <vector>

#include <xauto/parameter.h>
#include <xauto/result.h>
#include <xauto/topic.h>
#include <xauto/xmodule.h>

namespace xauto::testing {

/// What one firing did. A value; cheap to copy, and outlives its Fire.
class Outcome {
 public:
  /// Shares what it holds, which nobody changes.
  Outcome(const Outcome&);
  /// As the constructor.
  Outcome& operator=(const Outcome&);
  ~Outcome();

  /// What the module published on one of its output topics. Throws std::logic_error if that is no
  /// output of the module, or of another type.
  template <class T>
  [[nodiscard]] const T& get(const Topic<T>& topic) const {
    return *static_cast<const T*>(find(topic.name(), typeid(T)).get());
  }
  /// XNodes, in the order in which they ran.
  [[nodiscard]] std::vector<std::string> xnodes() const;
  /// When one began, in virtual time since the Fire was made; 0 of one that is not there.
  [[nodiscard]] std::chrono::microseconds start(const std::string& xnode) const;
  /// ... and ended: later by what it ran on emu::Context, equal without.
  [[nodiscard]] std::chrono::microseconds end(const std::string& xnode) const;

 private:
  friend class Fire;
  struct Data;
  explicit Outcome(std::shared_ptr<const Data> data);
  [[nodiscard]] const std::shared_ptr<const void>& find(const std::string& topic,
                                                        const std::type_info& type) const;
  std::shared_ptr<const Data> data_;
};

/// Fires a module:
///
///   xauto::testing::Fire fire(lanes);
///   const auto outcome = fire.put(image, Image{...}).run();
///   ASSERT_TRUE(outcome) << outcome.error().to_string();
///   EXPECT_EQ(outcome->get(steering).angle, 0);
///
/// The state is made once, so that several firings follow each other as in a run; so is what each
/// `init` makes, which goes with this object. Time is virtual: emu::Context::run takes what it is
/// told and does not sleep; whatever else an `exec` does takes none. Threads: one.
class Fire {
 public:
  /// XNodes that are added to `module` later are not seen.
  template <class State>
  explicit Fire(const XModule<State>& module) : Fire(module.spec_) {}
  Fire(const Fire&) = delete;
  Fire& operator=(const Fire&) = delete;
  ~Fire();

  /// Which implementation of an XNode runs, by the type of XPU. Default: the one added first.
  /// Before the first run().
  Fire& on(const std::string& xnode, const XPU& type);
  /// The next message of an input topic; stays there for further firings until it is replaced.
  template <class T>
  Fire& put(const Topic<T>& topic, T message) {
    put(detail::topic_spec(topic), std::make_shared<const T>(std::move(message)));
    return *this;
  }

  /// The value of a parameter of the module, from the next firing on. Default: as declared.
  template <class T>
  Fire& set(const Parameter<T>& parameter, T value) {
    if constexpr (std::is_same_v<T, std::string>)
      set_text(parameter.spec_, std::move(value));
    else if constexpr (std::is_same_v<T, double>)
      set_real(parameter.spec_, value);
    else
      set_integer(parameter.spec_, static_cast<std::int64_t>(value));
    return *this;
  }

  /// What Input::due and Input::result_due say from the next firing on: so long after its begin, a
  /// time above 0. Default: nothing, as where no policy of keys says.
  Fire& due(std::chrono::nanoseconds within);

  /// Runs the XNodes one after the other, on this thread. The number of the activation, from 0 on,
  /// is Input::sequence(), the virtual time Input::origin(). Errors: kInvalid of an input topic
  /// without a message, of a name or type that the module does not have, and of a module that the
  /// App would refuse, too. kUnavailable with what an `init`, `exec` or output threw. What `exec`
  /// returned. `where` names the XNode. After an error the next run() is a new activation.
  [[nodiscard]] Result<Outcome> run();

 private:
  struct Data;
  explicit Fire(std::shared_ptr<detail::XModuleSpec> module);
  void put(detail::TopicHandle topic, std::shared_ptr<const void> message);
  void set_integer(detail::ParameterHandle parameter, std::int64_t value);
  void set_real(detail::ParameterHandle parameter, double value);
  void set_text(detail::ParameterHandle parameter, std::string value);
  std::unique_ptr<Data> data_;
};

}  // namespace xauto::testing
