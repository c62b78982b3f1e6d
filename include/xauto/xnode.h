// SPDX-License-Identifier: Apache-2.0
// XNode: one stage of an algorithm, with one implementation per XPU type.
#pragma once

#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>

#include <xauto/parameter.h>
#include <xauto/result.h>
#include <xauto/topic.h>
#include <xauto/xpu.h>

namespace xauto {

namespace detail {

struct XNodeSpecErased;
/// `object`: set to what the implementation owns of one XPU instance; destroyed on the worker's
/// thread when the run ends.
using Init = std::function<SchedHandle(const XpuId&, void* state, std::shared_ptr<void>& object)>;
using Exec = std::function<Status(void* object, void* state, const Input&)>;

std::shared_ptr<XNodeSpecErased> make_xnode(std::string name);
const std::string& name_of(const XNodeSpecErased& xnode);
struct Stage {
  Init init;
  Exec exec;
  bool init_sees_state = false;  ///< it is called again for another State
};
void add_impl(XNodeSpecErased& xnode, const XPU& xpu, Stage stage);
void add_variant(XNodeSpecErased& xnode, const std::string& variant, int quality_pct,
                 const XPU& xpu, Stage stage);
void add_parameter(XNodeSpecErased& xnode, ParameterHandle parameter);

}  // namespace detail

/// What an `init` returns whose implementation owns something (an engine, a context, weights): the
/// object and the handle of one XPU instance.
template <class T>
struct Owned {
  std::unique_ptr<T> object;  ///< not null
  SchedHandle handle;         ///< behind which the object's work is queued
};
/// `return own(std::make_unique<Engine>(xpu), SchedHandle::cuda_context(context));`
template <class T>
[[nodiscard]] Owned<T> own(std::unique_ptr<T> object, SchedHandle handle) {
  return {std::move(object), std::move(handle)};
}

namespace detail {
template <class T>
struct OwnedBy {
  using Object = void;
};
template <class T>
struct OwnedBy<Owned<T>> {
  using Object = T;
};
}  // namespace detail

/// One stage that works on `State`, the state its module shares between its XNodes.
///
/// A handle: copies name the same XNode. Threads: build it from one thread; the callbacks run one
/// at a time per module, but not always on the same thread.
template <class State>
class XNode {
 public:
  /// `name` must be unique in the app; by convention "module.stage".
  explicit XNode(std::string name) : spec_(detail::make_xnode(std::move(name))) {}

  /// Adds the implementation for one type of XPU.
  ///
  /// init, of a `const XpuId&`, or of `(State&, const XpuId&)`: called once per XPU instance on which this XNode is to
  ///   run, and per State, on the worker's execution thread, before the first exec; those of one State one after the
  ///   other. Load the weights, create the context. It returns
  ///   - `SchedHandle`, or a CUcontext or cudlaDevHandle itself, if the implementation owns nothing, or
  ///   - `Owned<T>` (see own()): the T is this instance's, is given to each exec there, and is
  ///     destroyed on the same thread when the run ends, in the reverse order of the inits.
  /// exec: `void` or `Status`, of `(State&, const Input&)`, or of `(T&, State&, const Input&)` if
  ///   init returns an Owned<T>; what needs no input may leave that out. Runs the stage to its end: when it returns, the XPU has finished.
  ///   An exception or an error drops the activation, is counted and reported; the App goes on.
  template <class Init, class Exec>
  XNode& add_impl(const XPU& xpu, Init init, Exec exec) {
    detail::add_impl(*spec_, xpu, erase(std::move(init), std::move(exec)));
    return *this;
  }

  /// Adds another implementation for one type of XPU: less work, and a result of so much less quality
  /// (1 to 100 percent of the XNode's own). Runs where a set of tables says so, in scenarios that its
  /// user marks as degraded; an XNode has its own implementation beside. The same `variant` on another
  /// type has the same quality. init and exec: as add_impl.
  template <class Init, class Exec>
  XNode& add_variant(const std::string& variant, int quality_pct, const XPU& xpu, Init init,
                     Exec exec) {
    detail::add_variant(*spec_, variant, quality_pct, xpu, erase(std::move(init), std::move(exec)));
    return *this;
  }

  /// Its implementations read this parameter; it is one of the module's. Declared twice is once.
  template <class T>
  XNode& add_parameter(const Parameter<T>& parameter) {
    detail::add_parameter(*spec_, parameter.spec_);
    return *this;
  }

  /// As given.
  [[nodiscard]] const std::string& name() const { return detail::name_of(*spec_); }

 private:
  template <class>
  friend class XModule;
  template <class Init, class Exec>
  static detail::Stage erase(Init init, Exec exec) {
    constexpr bool kSeesState = std::is_invocable_v<Init&, State&, const XpuId&>;
    static_assert(kSeesState || std::is_invocable_v<Init&, const XpuId&>,
                  "init takes a const XpuId&, or (State&, const XpuId&)");
    auto make = [init = std::move(init)](const XpuId& id, void* state) mutable {
      if constexpr (kSeesState)
        return init(*static_cast<State*>(state), id);
      else
        return init(id);
    };
    using Made = std::invoke_result_t<decltype(make)&, const XpuId&, void*>;
    using Object = typename detail::OwnedBy<Made>::Object;
    if constexpr (std::is_void_v<Object>) {
      static_assert(std::is_convertible_v<Made, SchedHandle>,
                    "init returns a SchedHandle, or what own() makes");
      static_assert(takes<Exec, State&>,
                    "exec is void or Status of (State&, const Input&) or (State&)");
      return {[make = std::move(make)](const XpuId& id, void* state, std::shared_ptr<void>&) mutable
              -> SchedHandle { return make(id, state); },
              [exec = std::move(exec)](void*, void* state, const Input& input) mutable -> Status {
                return call(exec, input, *static_cast<State*>(state));
              },
              kSeesState};
    } else {
      static_assert(takes<Exec, Object&, State&>,
                    "exec is void or Status of (T&, State&, const Input&) or (T&, State&), T being "
                    "what init owns");
      return {[make = std::move(make)](const XpuId& id, void* state,
                                       std::shared_ptr<void>& object) mutable -> SchedHandle {
                Owned<Object> made = make(id, state);
                if (made.object == nullptr) throw std::logic_error("init owns a null object");
                object = std::move(made.object);
                return std::move(made.handle);
              },
              [exec = std::move(exec)](void* object, void* state,
                                       const Input& input) mutable -> Status {
                return call(exec, input, *static_cast<Object*>(object),
                            *static_cast<State*>(state));
              },
              kSeesState};
    }
  }
  template <class Exec, class... Arguments>
  static constexpr bool takes = std::is_invocable_v<Exec&, Arguments..., const Input&> ||
                                std::is_invocable_v<Exec&, Arguments...>;
  template <class Exec, class... Arguments>
  static Status call(Exec& exec, const Input& input, Arguments&... arguments) {
    const auto run = [&] {
      if constexpr (std::is_invocable_v<Exec&, Arguments&..., const Input&>)
        return exec(arguments..., input);
      else
        return exec(arguments...);
    };
    if constexpr (std::is_same_v<decltype(run()), Status>) {
      return run();
    } else {
      run();
      return {};
    }
  }
  std::shared_ptr<detail::XNodeSpecErased> spec_;
};

}  // namespace xauto
