// SPDX-License-Identifier: Apache-2.0
// The functions are those of CUDA's driver API 11 and later; cuda.h gives some of them the suffix _v2.
#include "kernel/cuda_levels.h"

#include <dlfcn.h>

// UBSan compares the types of functions, where both sides are compiled with it.
#ifdef __clang__
#define XAUTO_LIKE_C __attribute__((no_sanitize("function")))
#else
#define XAUTO_LIKE_C
#endif

namespace xauto::kernel {
namespace {

constexpr int kSuccess = 0;

class Driver {
 public:
  explicit Driver(const char* library) : library_(dlopen(library, RTLD_NOW | RTLD_LOCAL)) {}
  ~Driver() {
    if (library_ != nullptr) dlclose(library_);
  }
  Driver(const Driver&) = delete;
  Driver& operator=(const Driver&) = delete;

  /// False where there is no such function, too. An enum and pointers of CUDA's are an int and void* here.
  template <class... Arguments>
  [[nodiscard]] XAUTO_LIKE_C bool call(const char* function, Arguments... arguments) const {
    if (library_ == nullptr) return false;
    const auto found = reinterpret_cast<int (*)(Arguments...)>(dlsym(library_, function));
    return found != nullptr && found(arguments...) == kSuccess;
  }

 private:
  void* library_;
};

}  // namespace

int cuda_stream_levels(int index, const char* library) {
  const Driver cuda(library);
  int device = 0, least = 0, greatest = 0;
  void *context = nullptr, *popped = nullptr;
  if (!cuda.call("cuInit", 0U) || !cuda.call("cuDeviceGet", &device, index) ||
      !cuda.call("cuDevicePrimaryCtxRetain", &context, device))
    return 0;
  bool told = false;
  if (cuda.call("cuCtxPushCurrent_v2", context)) {
    told = cuda.call("cuCtxGetStreamPriorityRange", &least, &greatest);
    (void)cuda.call("cuCtxPopCurrent_v2", &popped);
  }
  (void)cuda.call("cuDevicePrimaryCtxRelease_v2", device);
  const int levels = least - greatest + 1;  // the greatest priority is the smallest number
  return told && levels >= 2 ? levels : 0;
}

}  // namespace xauto::kernel
