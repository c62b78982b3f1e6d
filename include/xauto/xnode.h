// SPDX-License-Identifier: Apache-2.0
// XNode: one stage of an algorithm, with one implementation per XPU type.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include <xauto/result.h>
#include <xauto/topic.h>
#include <xauto/xpu.h>

namespace xauto {

namespace detail {

struct ImplSpec {
  XPU xpu{"cpu"};
  std::function<SchedHandle(const XpuId&)> init;
  std::function<Status(void* state, const Input&)> exec;
};

struct XNodeSpecErased {
  std::string name;
  std::type_index state = typeid(void);
  std::vector<ImplSpec> impls;
  std::vector<std::string> misuse;  ///< collected, reported by App when it is built
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
  explicit XNode(std::string name) : spec_(std::make_shared<detail::XNodeSpecErased>()) {
    spec_->name = std::move(name);
    spec_->state = typeid(State);
  }

  /// Adds the implementation for one type of XPU.
  ///
  /// init: `SchedHandle(const XpuId&)`. Called once per XPU instance on which this XNode is to run,
  ///   on the worker's execution thread, before the first exec: load the weights, create the
  ///   CUcontext, return the handle.
  /// exec: `void(State&, const Input&)` or `Status(State&, const Input&)`. Runs the stage to its
  ///   end: when it returns, the XPU has finished. An exception or an error drops the activation,
  ///   is counted and reported; the App goes on.
  template <class Init, class Exec>
  XNode& add_impl(XPU xpu, Init init, Exec exec) {
    static_assert(std::is_invocable_r_v<SchedHandle, Init, const XpuId&>,
                  "init is SchedHandle(const XpuId&)");
    static_assert(std::is_invocable_v<Exec, State&, const Input&>,
                  "exec is void(State&, const Input&) or Status(State&, const Input&)");
    for (const auto& impl : spec_->impls)
      if (impl.xpu == xpu)
        spec_->misuse.push_back("XNode '" + spec_->name + "' has two implementations for '" +
                                xpu.type() + "'");
    spec_->impls.push_back(
        {std::move(xpu), std::move(init),
         [exec = std::move(exec)](void* state, const Input& input) mutable -> Status {
           if constexpr (std::is_same_v<std::invoke_result_t<Exec, State&, const Input&>, Status>) {
             return exec(*static_cast<State*>(state), input);
           } else {
             exec(*static_cast<State*>(state), input);
             return {};
           }
         }});
    return *this;
  }

  /// As given.
  [[nodiscard]] const std::string& name() const { return spec_->name; }

 private:
  template <class>
  friend class XModule;
  std::shared_ptr<detail::XNodeSpecErased> spec_;
};

}  // namespace xauto
