// SPDX-License-Identifier: Apache-2.0
// Two modules on a GPU, each with a context of two queues of a driver, made with the driver's own
// ioctls as CUDA or ROCm would: tests/devices has such drivers.
//
//   queuesapp nvgpu|rm|kfd|i915 HOLD
//
// A job of `slow` lasts until one of `quick`, which is more urgent, has run; or for 200 ms, for one
// that is late is the more urgent itself. One of `quick` that meets such a job lasts while the file
// HOLD is there. On i915 a job is a request in each queue, which is done when the job is.
#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include <fcntl.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <xauto/xauto.h>

namespace {

using namespace std::chrono_literals;

template <class Args>
void call(int fd, unsigned long request, Args& args) {
  if (ioctl(fd, request, &args) != 0) throw std::runtime_error("a driver refused");
}
int node(const char* path) {
  const int fd = open(path, O_RDWR | O_CLOEXEC);
  if (fd < 0) throw std::runtime_error(std::string("cannot open ") + path);
  return fd;
}

void open_nvgpu() {
  const int ctrl = node("/dev/nvgpu/igpu0/ctrl");
  for (int i = 0; i < 2; ++i) {
    std::uint32_t tsg[6] = {};
    int channel = -1;
    call(ctrl, 0xc0184709, tsg);
    call(ctrl, 0xc004470b, channel);
    call(static_cast<int>(tsg[0]), 0x40045401, channel);
  }
  close(ctrl);
}

std::uint32_t rm_object(int fd, std::uint32_t client, std::uint32_t parent, std::uint32_t type) {
  std::uint32_t args[12] = {client, parent, 0, type};
  call(fd, 0xc030462b, args);
  if (args[10] != 0) throw std::runtime_error("RM refused");
  return args[2];
}
void open_rm() {
  const int fd = node("/dev/nvidiactl");
  const std::uint32_t client = rm_object(fd, 0, 0, 0x41);
  const std::uint32_t device = rm_object(fd, client, client, 0x80);
  (void)rm_object(fd, client, device, 0x2080);
  for (int i = 0; i < 2; ++i)
    (void)rm_object(fd, client, rm_object(fd, client, device, 0xa06c), 0xc86f);
}

void open_kfd() {
  static const int fd = node("/dev/kfd");
  for (int i = 0; i < 2; ++i) {
    struct {
      std::uint64_t ring = 0x7f0000100000, write = 0, read = 0, doorbell = 0;
      std::uint32_t size = 65536, gpu = 0, type = 2, percentage = 100, priority = 7, id = 0;
      std::uint64_t rest[4] = {};
    } args;
    call(fd, 0xc0584b02, args);
  }
}

struct I915Request {
  int fd;
  std::uint32_t context;
  void queue() const {
    const std::uint32_t object[14] = {context};  // one that has its number
    struct {
      std::uint64_t objects;
      std::uint32_t count = 1, rest[7] = {};
      std::uint64_t flags = 0, context, pad = 0;
    } args{.objects = reinterpret_cast<std::uintptr_t>(object), .context = context};
    static_assert(sizeof args == 64);
    call(fd, 0x40406469, args);
  }
  void wait() const {
    struct {
      std::uint32_t object, flags = 0;
      std::int64_t timeout = -1;
    } args{.object = context};
    call(fd, 0xc010646c, args);
  }
};
std::vector<I915Request> g_requests[2];  ///< quick's, slow's

void open_i915(std::vector<I915Request>& requests) {
  const int fd = node("/dev/dri/renderD128");
  for (int i = 0; i < 2; ++i) {
    std::uint32_t context[2] = {};
    call(fd, 0xc008646d, context);
    requests.push_back({fd, context[0]});
  }
}

struct State {
  int done = 0;
};

std::atomic<int> g_quick{0};       ///< jobs of quick's that have run
std::atomic<bool> g_slow{false};   ///< one of slow's is at it
std::atomic<bool> g_holds{false};  ///< ... and has met one of quick's, which lasts
std::string g_driver, g_hold;

void add(xauto::App& app, const std::string& name, std::chrono::milliseconds period) {
  const xauto::Topic<int> in(name), out(name + "/out");
  app.add_source(in, period, [](std::uint64_t k) { return static_cast<int>(k); });
  const int which = name == "quick" ? 0 : 1;
  xauto::XNode<State> node(name + ".run");
  node.add_impl(
      xauto::XPU::GPU,
      [which](const xauto::XpuId&) {
        if (g_driver == "i915")
          open_i915(g_requests[which]);
        else
          (g_driver == "rm" ? open_rm : g_driver == "kfd" ? open_kfd : open_nvgpu)();
        static int contexts[2];
        return xauto::SchedHandle::cuda_context(&contexts[which]);
      },
      [which](State& state, const xauto::Input&) {
        for (const I915Request& request : g_requests[which]) request.queue();
        if (which == 1) {
          g_slow = true;
          const auto limit = std::chrono::steady_clock::now() + 200ms;
          for (const int before = g_quick;
               g_quick == before && (g_holds || std::chrono::steady_clock::now() < limit);)
            std::this_thread::sleep_for(500us);
          g_slow = false;
        } else {
          while (g_slow && access(g_hold.c_str(), F_OK) == 0) {
            g_holds = true;
            std::this_thread::sleep_for(500us);
          }
          g_holds = false;
          ++g_quick;
        }
        for (const I915Request& request : g_requests[which]) request.wait();
        ++state.done;
        return xauto::Status();
      });
  xauto::XModule<State> module(name + "M");
  module.add_node(node).add_input_topic(in).add_output_topic(out, &State::done);
  app.add_module(module);
}

}  // namespace

int main(int argc, char** argv) {
  g_driver = argc > 1 ? argv[1] : "nvgpu";
  g_hold = argc > 2 ? argv[2] : "/nonexistent";
  xauto::App app("queues");
  add(app, "quick", 20ms);
  add(app, "slow", 200ms);
  return app.main(argc, argv);
}
