// SPDX-License-Identifier: Apache-2.0
// An XNode from algorithms of NVIDIA's VPI, on a Jetson's VIC or PVA. Only for apps that have VPI 2 or newer
// (vpi/Stream.h, libnvvpi). Compiled and tested against declarations written from NVIDIA's documentation; not run on
// hardware yet.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <vpi/Status.h>
#include <vpi/Stream.h>
#include <vpi/Types.h>

#include <xauto/result.h>
#include <xauto/xnode.h>
#include <xauto/xpu.h>

/// XNodes from VPI's algorithms: vpi.h.
namespace xauto::vpi {

/// What a call of VPI answered: its name, VPI's name of the error, and VPI's words. kInvalid: the call was wrong;
/// kUnavailable: everything else.
[[nodiscard]] inline Status checked(VPIStatus status, const char* call) {
  if (status == VPI_SUCCESS) return {};
  char words[VPI_MAX_STATUS_MESSAGE_LENGTH] = {};
  (void)vpiGetLastStatusMessage(words, VPI_MAX_STATUS_MESSAGE_LENGTH);
  words[sizeof words - 1] = '\0';
  return fail(status == VPI_ERROR_INVALID_ARGUMENT ? ErrorCode::kInvalid : ErrorCode::kUnavailable,
              std::string(vpiStatusGetName(status)) + (words[0] == '\0' ? "" : ": ") + words, call);
}

/// A stream on one kind of engine, and what it works with. Threads: one at a time.
class Session {
 public:
  /// `backend`: VPI_BACKEND_VIC, VPI_BACKEND_PVA or another one, alone: then VPI takes no other processor, which no plan
  /// knows of. Errors: kInvalid: several; otherwise VPI's own.
  [[nodiscard]] static Result<std::unique_ptr<Session>> open(std::uint64_t backend) {
    if (backend == 0 || (backend & (backend - 1)) != 0)
      return fail(ErrorCode::kInvalid, "names not one backend", "vpi::Session",
                  "an XNode is on one XPU: give it VPI_BACKEND_VIC or VPI_BACKEND_PVA");
    std::unique_ptr<Session> made(new Session(backend));
    XAUTO_TRY(checked(vpiStreamCreate(backend, &made->stream_), "vpiStreamCreate"));
    return made;
  }
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;
  /// Waits for what it was given, then for what it keeps, the last one first.
  ~Session() {
    if (stream_ != nullptr) (void)vpiStreamSync(stream_);
    for (auto last = kept_.rbegin(); last != kept_.rend(); ++last) (*last)();
    if (stream_ != nullptr) vpiStreamDestroy(stream_);
  }

  /// For vpiSubmit...(session.stream(), session.backend(), ...).
  [[nodiscard]] VPIStream stream() const { return stream_; }
  /// As given.
  [[nodiscard]] std::uint64_t backend() const { return backend_; }
  /// An image, payload or array that goes with the session: keep(image, vpiImageDestroy). Returns it.
  template <class Object>
  Object keep(Object object, void (*destroy)(Object)) {
    kept_.push_back([object, destroy] { destroy(object); });
    return object;
  }
  /// Waits until the stream is empty: call it at the end of each exec.
  [[nodiscard]] Status sync() const { return checked(vpiStreamSync(stream_), "vpiStreamSync"); }
  /// Nobody takes work off a VIC or a PVA again.
  [[nodiscard]] SchedHandle handle() const { return SchedHandle::gate(); }

 private:
  explicit Session(std::uint64_t backend) : backend_(backend) {}
  std::uint64_t backend_;
  VPIStream stream_ = nullptr;
  std::vector<std::function<void()>> kept_;
};

/// The `init` of an XNode that owns a Session; its exec gets that. `setup`, Status of (Session&): makes images and
/// payloads there, which exec finds in what `setup` captured, or in the State. VPI chooses itself which of several PVAs
/// works: plan with one.
[[nodiscard]] inline auto load(std::uint64_t backend, std::function<Status(Session&)> setup = {}) {
  return [backend, setup = std::move(setup)](const XpuId&) {
    Result<std::unique_ptr<Session>> session = Session::open(backend);
    if (!session) throw std::runtime_error(session.error().to_string());
    if (setup)
      if (const Status ready = setup(**session); !ready)
        throw std::runtime_error(ready.error().to_string());
    const SchedHandle handle = session.value()->handle();
    return own(std::move(session).value(), handle);
  };
}

}  // namespace xauto::vpi
