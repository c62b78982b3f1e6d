// SPDX-License-Identifier: Apache-2.0
// A stranger's attack: netlink and ioctls written from include/uapi alone, nothing of lib/. Several
// processes, some without privileges, do XAUTO_ATTACK operations (2000) with a seed that is printed
// (XAUTO_SEED): they register their own, others' and no queues, suspend, resume, lie about sizes
// and handles, close in the middle, reopen under the same port, are killed in the middle, and the
// module goes and comes under them. Afterwards the emulated drivers, not the module, are asked what
// is still suspended. In the KASAN lane it is 10^5.
#include <array>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <functional>
#include <random>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include <fcntl.h>
#include <kselftest.h>
#include <linux/genetlink.h>
#include <linux/netlink.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <uapi/xauto/emu.h>
#include <uapi/xauto/netlink.h>
#include <uapi/xauto/nvdla.h>
#include <uapi/xauto/nvgpu.h>
#include <unistd.h>

namespace {

constexpr int kAttackers = 8, kVictims = 3, kUser = 1000;
constexpr int kSilent = -1;  ///< in place of an errno: no answer came

enum Kind {
  kRegister,
  kRegisterForeign,
  kSuspend,
  kResume,
  kTune,
  kBatch,
  kUnregister,
  kWrongHandle,
  kMalformed,
  kLies,
  kWatchdog,
  kRead,
  kReopen,
  kLeave,
  kGpu,
  kDla,
  kNewFile,
  kOrphan,
  kTwoThreads,
  kUnload,
  kShare,
  kListen,
  kKinds
};

/// What all processes write to.
struct Shared {
  std::atomic<long> done, granted, suspends, wrong, silent;
  std::array<std::atomic<long>, kKinds> kinds;
  char first_wrong[120];
  std::atomic<pid_t> pids[kAttackers + kVictims];
  std::atomic<bool> calm;                    ///< victims: change nothing any more
  std::atomic<int> calmed;                   ///< how many have heard it
  std::atomic<int> victim_queues[kVictims];  ///< descriptor of the one that is released at times
};
Shared* shared;

void wrong(const char* what) {
  if (shared->wrong.fetch_add(1) == 0)
    strncpy(shared->first_wrong, what, sizeof shared->first_wrong - 1);
}

std::mt19937_64 random_source;
std::uint32_t below(std::uint32_t limit) {
  return static_cast<std::uint32_t>(random_source() % limit);
}
bool one_in(std::uint32_t n) {
  return below(n) == 0;
}

// --- netlink ----------------------------------------------------------------------------------

/// A message under construction.
struct Message {
  alignas(4) unsigned char bytes[8192];
  std::uint32_t size = 0;

  Message(int family, std::uint8_t command, int flags) {
    nlmsghdr header{};
    header.nlmsg_type = static_cast<std::uint16_t>(family);
    header.nlmsg_flags = static_cast<std::uint16_t>(NLM_F_REQUEST | flags);
    add(&header, sizeof header);
    const genlmsghdr generic{command, 1, 0};
    add(&generic, sizeof generic);
  }
  void add(const void* data, std::size_t length) {
    memcpy(bytes + size, data, length);
    size += static_cast<std::uint32_t>(length);
    while (size % 4 != 0) bytes[size++] = 0;
  }
  std::uint32_t open(int type) {
    const std::uint32_t at = size;
    const nlattr attribute{NLA_HDRLEN, static_cast<std::uint16_t>(type)};
    add(&attribute, sizeof attribute);
    return at;
  }
  void close(std::uint32_t at, std::uint32_t lie = 0) {
    const auto length = static_cast<std::uint16_t>(size - at + lie);
    memcpy(bytes + at, &length, sizeof length);
  }
  Message& put(int type, const void* data, std::size_t length) {
    const nlattr attribute{static_cast<std::uint16_t>(NLA_HDRLEN + length),
                           static_cast<std::uint16_t>(type)};
    add(&attribute, sizeof attribute);
    add(data, length);
    return *this;
  }
  Message& put(int type, std::uint32_t value) { return put(type, &value, sizeof value); }
  void op(std::uint32_t number, std::uint32_t action, std::uint32_t handle, std::uint32_t value) {
    const std::uint32_t nest = open(static_cast<int>(number) | NLA_F_NESTED);
    put(XAUTO_OP_ACTION, action).put(XAUTO_OP_HANDLE, handle).put(XAUTO_OP_VALUE, value);
    close(nest);
  }
};

/// A socket, which is an owner once something is registered on it.
struct Line {
  int fd = -1, family = 0, group = 0;
  std::uint32_t sequence = 0;  ///< of what was said last
  std::uint32_t handle = 0;    ///< that the last answer named
  long listed = 0;             ///< queues in the last dump

  bool open(std::uint32_t port = 0) {
    fd = socket(AF_NETLINK, SOCK_RAW | SOCK_CLOEXEC, NETLINK_GENERIC);
    sockaddr_nl address{};
    address.nl_family = AF_NETLINK;
    address.nl_pid = port;
    if (bind(fd, reinterpret_cast<sockaddr*>(&address), sizeof address) != 0 && port == 0)
      return false;
    const timeval limit{60, 0};
    setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &limit, sizeof limit);
    return look_up();
  }
  bool look_up() {
    Message message(GENL_ID_CTRL, CTRL_CMD_GETFAMILY, NLM_F_ACK);
    message.put(CTRL_ATTR_FAMILY_NAME, XAUTO_FAMILY_NAME, sizeof XAUTO_FAMILY_NAME);
    family = 0;
    return ask(message) == 0 && family != 0;
  }
  std::uint32_t port() const {
    sockaddr_nl address{};
    socklen_t length = sizeof address;
    getsockname(fd, reinterpret_cast<sockaddr*>(&address), &length);
    return address.nl_pid;
  }
  void hang_up() {
    ::close(fd);
    fd = -1;
  }
  /// @size of the header and of the datagram, where they are to differ from the truth.
  bool say(Message& message, std::uint32_t claimed = 0, std::uint32_t sent = 0) {
    const std::uint32_t length = claimed != 0 ? claimed : message.size;
    auto* header = reinterpret_cast<nlmsghdr*>(message.bytes);
    header->nlmsg_len = length;
    header->nlmsg_seq = ++sequence;
    sockaddr_nl kernel{};
    kernel.nl_family = AF_NETLINK;
    return sendto(fd, message.bytes, sent != 0 ? sent : message.size, 0,
                  reinterpret_cast<sockaddr*>(&kernel), sizeof kernel) >= 0;
  }
  /// 0, an errno, or kSilent. What answers an earlier message is not listened to.
  int hear() {
    alignas(4) unsigned char buffer[16384];
    handle = 0;
    listed = 0;
    for (;;) {
      const ssize_t got = recv(fd, buffer, sizeof buffer, 0);
      if (got < 0) return errno == EAGAIN ? kSilent : errno;
      auto left = static_cast<unsigned>(got);
      for (auto* m = reinterpret_cast<nlmsghdr*>(buffer); NLMSG_OK(m, left);
           m = NLMSG_NEXT(m, left)) {
        if (m->nlmsg_seq != sequence) continue;
        if (m->nlmsg_type == NLMSG_ERROR) return -static_cast<nlmsgerr*>(NLMSG_DATA(m))->error;
        if (m->nlmsg_type == NLMSG_DONE) return 0;
        ++listed;
        read_attributes(m);
      }
    }
  }
  void read_attributes(const nlmsghdr* message) {
    const auto* at = reinterpret_cast<const unsigned char*>(message) + NLMSG_HDRLEN + GENL_HDRLEN;
    const auto* end = reinterpret_cast<const unsigned char*>(message) + message->nlmsg_len;
    while (at + NLA_HDRLEN <= end) {
      nlattr attribute;
      memcpy(&attribute, at, sizeof attribute);
      if (attribute.nla_len < NLA_HDRLEN) return;
      const int type = attribute.nla_type & NLA_TYPE_MASK;
      if (message->nlmsg_type == GENL_ID_CTRL && type == CTRL_ATTR_FAMILY_ID) {
        std::uint16_t id;
        memcpy(&id, at + NLA_HDRLEN, sizeof id);
        family = id;
      } else if (message->nlmsg_type == GENL_ID_CTRL && type == CTRL_ATTR_MCAST_GROUPS) {
        // One group: a nest in a nest, its id or its name first.
        const unsigned char* inner = at + 2 * NLA_HDRLEN;
        for (int i = 0; i < 2 && inner + NLA_HDRLEN <= end; ++i) {
          memcpy(&attribute, inner, sizeof attribute);
          if (attribute.nla_type == CTRL_ATTR_MCAST_GRP_ID)
            memcpy(&group, inner + NLA_HDRLEN, sizeof group);
          inner += NLA_ALIGN(attribute.nla_len);
        }
        memcpy(&attribute, at, sizeof attribute);
      } else if (message->nlmsg_type != GENL_ID_CTRL && type == XAUTO_A_HANDLE) {
        memcpy(&handle, at + NLA_HDRLEN, sizeof handle);
      }
      at += NLA_ALIGN(attribute.nla_len);
    }
  }
  int ask(Message& message) {
    if (!say(message)) return errno;
    const int error = hear();
    if (error == kSilent) ++shared->silent;
    if (error == 0) ++shared->granted;
    return error;
  }
  int act(std::uint32_t action, std::uint32_t which, std::uint32_t value = 0) {
    Message message(family, XAUTO_CMD_CONTROL, NLM_F_ACK | (one_in(2) ? NLM_F_ECHO : 0));
    const std::uint32_t ops = message.open(XAUTO_A_OPS | NLA_F_NESTED);
    message.op(1, action, which, value);
    message.close(ops);
    const int error = ask(message);
    if (error == 0 && action == XAUTO_ACTION_SUSPEND) ++shared->suspends;
    return error;
  }
  int take(std::uint32_t type, int file, pid_t pid = 0) {
    Message message(family, XAUTO_CMD_REGISTER, NLM_F_ACK);
    message.put(XAUTO_A_TYPE, type).put(XAUTO_A_FD, static_cast<std::uint32_t>(file));
    if (pid != 0) message.put(XAUTO_A_PID, static_cast<std::uint32_t>(pid));
    return ask(message);
  }
  int about(std::uint8_t command, std::uint32_t which) {
    Message message(family, command, NLM_F_ACK);
    message.put(XAUTO_A_HANDLE, which);
    return ask(message);
  }
  int list() {
    Message message(family, XAUTO_CMD_GET, NLM_F_DUMP);
    return ask(message);
  }
};

// --- the drivers ------------------------------------------------------------------------------

int open_tsg() {
  const int ctrl = open("/dev/nvgpu/igpu0/ctrl", O_RDWR | O_CLOEXEC);
  nvgpu_gpu_open_tsg_args args{};
  const bool opened = ioctl(ctrl, NVGPU_GPU_IOCTL_OPEN_TSG, &args) == 0;
  close(ctrl);
  return opened ? static_cast<int>(args.tsg_fd) : -1;
}
int open_channel(int runlist) {
  const int ctrl = open("/dev/nvgpu/igpu0/ctrl", O_RDWR | O_CLOEXEC);
  nvgpu_gpu_open_channel_args args{};
  args.in.runlist_id = runlist;
  const bool opened = ioctl(ctrl, NVGPU_GPU_IOCTL_OPEN_CHANNEL, &args) == 0;
  close(ctrl);
  return opened ? args.out.channel_fd : -1;
}
int open_dla(int instance) {
  const int fd = open(instance == 0 ? "/dev/nvhost-ctrl-nvdla0" : "/dev/nvhost-ctrl-nvdla1",
                      O_RDWR | O_CLOEXEC);
  (void)ioctl(fd, NVDLA_IOCTL_ALLOC_QUEUE, 0);  // the pool may be empty
  return fd;
}
bool work(int channel, std::uint64_t us) {
  xauto_emu_work work{us * 1000, 0};
  return ioctl(channel, XAUTO_EMU_IOCTL_SUBMIT, &work) == 0;
}
bool task(int dla, std::uint64_t us) {
  xauto_emu_work work{us * 1000, 0};
  nvdla_submit_args args{};
  args.tasks = reinterpret_cast<std::uintptr_t>(&work);
  args.num_tasks = 1;
  args.version = XAUTO_EMU_TASK_VERSION;
  return ioctl(dla, NVDLA_IOCTL_EMU_TASK_SUBMIT, &args) == 0;
}
bool idle(int fd, int timeout_ms) {
  pollfd ready{fd, POLLIN, 0};
  return poll(&ready, 1, timeout_ms) == 1;
}
int descriptor_of(pid_t pid, int fd) {
  const int process = static_cast<int>(syscall(SYS_pidfd_open, pid, 0));
  if (process < 0) return -1;
  const int copy = static_cast<int>(syscall(SYS_pidfd_getfd, process, fd, 0));
  close(process);
  return copy;
}

// --- victims ----------------------------------------------------------------------------------

void become_user() {
  if (setgid(kUser) != 0 || setuid(kUser) != 0) _exit(9);
  prctl(PR_SET_DUMPABLE, 1);  // others of this user may take its descriptors
  prctl(PR_SET_PDEATHSIG, SIGKILL);
}

/// An app: two TSGs, a queue on each DLA, short work, and what makes drivers enable queues. Only
/// DLA 1's queue is released while others live: a slot that another process gets stays as it was.
[[noreturn]] void live(int number) {
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (number == kVictims - 1) become_user();
  const int tsgs[] = {open_tsg(), open_tsg()};
  const int channels[] = {open_channel(0), open_channel(1)};
  const int dlas[] = {open_dla(0), open_dla(1)};
  for (int i = 0; i < 2; ++i) {
    int channel = channels[i];
    if (tsgs[i] < 0 || ioctl(tsgs[i], NVGPU_TSG_IOCTL_BIND_CHANNEL, &channel) != 0) _exit(2);
  }
  shared->victim_queues[number] = dlas[1];
  bool told = false;
  for (;;) {
    const bool calm = shared->calm;
    if (calm && !told) {
      told = true;
      ++shared->calmed;
    }
    for (const int channel : channels)
      if (!work(channel, 100 + below(2000)) && errno != EAGAIN) _exit(3);  // killed: start anew
    for (const int dla : dlas)
      if (!task(dla, 100 + below(1000))) (void)ioctl(dla, NVDLA_IOCTL_ALLOC_QUEUE, 0);
    for (const int fd : {channels[0], channels[1], dlas[0], dlas[1]}) (void)idle(fd, 10);
    usleep(2000 + below(6000));  // the attackers need the CPUs more
    nvgpu_preemption_mode_args mode{};
    switch (calm ? 9 : below(10)) {
      case 0: {
        int another = open_channel(0);
        (void)ioctl(tsgs[0], NVGPU_TSG_IOCTL_BIND_CHANNEL, &another);
        close(another);
        break;
      }
      case 1:
        (void)ioctl(channels[1], NVGPU_IOCTL_CHANNEL_SET_PREEMPTION_MODE, &mode);
        break;
      case 2:
        (void)ioctl(dlas[1], NVDLA_IOCTL_RELEASE_QUEUE, 0);
        (void)ioctl(dlas[1], NVDLA_IOCTL_ALLOC_QUEUE, 0);
        break;
      default:
        break;
    }
  }
}

// --- attackers --------------------------------------------------------------------------------

struct File {
  int fd;
  std::uint32_t type;
};

struct Attacker {
  bool privileged;
  int forbidden_tsg, forbidden_dla;  ///< opened by root: to a user
  Line line{};
  std::vector<File> files{};
  std::vector<std::uint32_t> handles{};
  int channel = -1;
  std::uint32_t last_port = 0;

  void reopen(std::uint32_t port = 0) {
    handles.clear();
    while (!line.open(port)) {  // the module may be gone for a moment
      if (line.fd >= 0) line.hang_up();
      port = 0;
      usleep(2000);
    }
  }
  std::uint32_t some_handle() {
    return handles.empty() ? 1 : handles[below(static_cast<std::uint32_t>(handles.size()))];
  }
  void keep() {
    if (line.handle != 0 && handles.size() < 32) handles.push_back(line.handle);
  }
  /// Its family is gone if the module was unloaded.
  void check_family(int error) {
    if (error == ENOENT && one_in(4) && !line.look_up()) {
      line.hang_up();
      reopen();
    }
  }

  void new_file() {
    if (files.size() >= 6) {
      const std::size_t which = below(static_cast<std::uint32_t>(files.size()));
      close(files[which].fd);  // suspended or not
      files.erase(files.begin() + static_cast<std::ptrdiff_t>(which));
      return;
    }
    if (one_in(3)) {
      files.push_back({open_dla(static_cast<int>(below(2))), XAUTO_QUEUE_DLA});
    } else if (const int tsg = open_tsg(); tsg >= 0) {
      if (channel >= 0) close(channel);
      channel = open_channel(static_cast<int>(below(2)));
      (void)ioctl(tsg, NVGPU_TSG_IOCTL_BIND_CHANNEL, &channel);
      files.push_back({tsg, XAUTO_QUEUE_GPU_TSG});
    }
  }

  void take_own() {
    if (files.empty()) return new_file();
    const File& file = files[below(static_cast<std::uint32_t>(files.size()))];
    // The wrong type at times.
    const std::uint32_t type = one_in(8) ? 3 - file.type : file.type;
    const int error = line.take(type, file.fd);
    if (error == 0 && type != file.type) wrong("a queue of another kind was registered");
    if (error == 0) keep();
    check_family(error);
  }

  void take_foreign() {
    if (privileged && one_in(2)) {
      if (one_in(2) ? line.take(XAUTO_QUEUE_GPU_TSG, forbidden_tsg) == 0
                    : line.take(XAUTO_QUEUE_DLA, forbidden_dla) == 0)
        keep();
      return;
    }
    if (!privileged && one_in(2)) {
      const int error = one_in(2) ? line.take(XAUTO_QUEUE_GPU_TSG, forbidden_tsg)
                                  : line.take(XAUTO_QUEUE_DLA, forbidden_dla);
      if (error == 0) wrong("root's queue was registered by a user");
      return;
    }
    const pid_t pid = shared->pids[below(kAttackers + kVictims)];
    if (pid == 0) return;
    const int copy = descriptor_of(pid, 3 + static_cast<int>(below(20)));
    if (copy < 0) return;
    const int error = line.take(1 + below(2), copy, one_in(4) ? pid + 1 : pid);
    close(copy);
    if (error == 0) keep();
  }

  void batch() {
    const std::uint32_t count = 1 + below(one_in(8) ? 80 : 6);
    Message message(line.family, XAUTO_CMD_CONTROL, NLM_F_ACK | (one_in(2) ? NLM_F_ECHO : 0));
    const std::uint32_t ops = message.open(XAUTO_A_OPS | NLA_F_NESTED);
    for (std::uint32_t i = 1; i <= count; ++i)
      message.op(i, 1 + below(4), one_in(12) ? below(40) : some_handle(),
                 one_in(2) ? 1000 + below(4000) : below(4));
    message.close(ops);
    if (line.ask(message) == 0 && count > XAUTO_MAX_OPS) wrong("a batch above the limit was taken");
  }

  void wrong_handle() {
    const std::uint32_t handle = 0x7ffff000 + below(64);
    const int error = one_in(3)   ? line.about(XAUTO_CMD_UNREGISTER, handle)
                      : one_in(2) ? line.about(XAUTO_CMD_GET, handle)
                                  : line.act(1 + below(4), handle, 2000);
    if (error == 0) wrong("a handle that was never given was taken");
  }

  /// Each of these is wrong in one way.
  void malformed() {
    const std::uint32_t handle = some_handle();
    const int file = files.empty() ? 0 : files[0].fd;
    const char* what = "";
    Message message(line.family, XAUTO_CMD_REGISTER, NLM_F_ACK);
    const auto control = [&] { message = Message(line.family, XAUTO_CMD_CONTROL, NLM_F_ACK); };
    switch (below(11)) {
      case 0:
        what = "no TYPE";
        message.put(XAUTO_A_FD, static_cast<std::uint32_t>(file));
        break;
      case 1:
        what = "a TYPE that there is not";
        message.put(XAUTO_A_TYPE, 3 + below(9)).put(XAUTO_A_FD, static_cast<std::uint32_t>(file));
        break;
      case 2: {
        what = "a file that is no queue";
        const int none = eventfd(0, EFD_CLOEXEC);
        const int error = line.take(1 + below(2), none);
        close(none);
        if (error == 0) wrong(what);
        return;
      }
      case 3:
        what = "a descriptor that is none";
        message.put(XAUTO_A_TYPE, 1).put(XAUTO_A_FD, 900 + below(1u << 31));
        break;
      case 4:
        what = "an unknown attribute";
        message.put(XAUTO_A_TYPE, 1).put(XAUTO_A_FD, static_cast<std::uint32_t>(file));
        message.put(static_cast<int>(XAUTO_A_MAX + 1 + below(60)), 1);
        break;
      case 5: {
        what = "a number of a wrong size";
        const std::uint64_t value = 1;
        static const std::size_t sizes[] = {0, 1, 2, 3};
        message.put(XAUTO_A_TYPE, &value, sizes[below(4)]);
        message.put(XAUTO_A_FD, static_cast<std::uint32_t>(file));
        break;
      }
      case 6: {
        what = "operations that end behind the message";
        control();
        const std::uint32_t ops = message.open(XAUTO_A_OPS | NLA_F_NESTED);
        message.op(1, XAUTO_ACTION_SUSPEND, handle, 0);
        message.close(ops, 4 + below(4000));
        break;
      }
      case 7: {
        what = "an operation that is longer than its list";
        control();
        const std::uint32_t ops = message.open(XAUTO_A_OPS | NLA_F_NESTED);
        const std::uint32_t op = message.open(1 | NLA_F_NESTED);
        message.put(XAUTO_OP_ACTION, XAUTO_ACTION_SUSPEND).put(XAUTO_OP_HANDLE, handle);
        message.close(op, 8 + below(60000));
        message.close(ops);
        break;
      }
      case 8: {
        what = "65 operations and more";
        control();
        const std::uint32_t ops = message.open(XAUTO_A_OPS | NLA_F_NESTED);
        for (std::uint32_t i = XAUTO_MAX_OPS + 1 + below(30); i > 0; --i)
          message.op(i, XAUTO_ACTION_SUSPEND, handle, 0);
        message.close(ops);
        break;
      }
      case 9: {
        what = "an action that there is not";
        control();
        const std::uint32_t ops = message.open(XAUTO_A_OPS | NLA_F_NESTED);
        message.op(1, one_in(2) ? 0 : 5 + below(9), handle, 0);
        message.close(ops);
        break;
      }
      default:
        what = "an operation without a handle";
        control();
        const std::uint32_t ops = message.open(XAUTO_A_OPS | NLA_F_NESTED);
        const std::uint32_t op = message.open(1 | NLA_F_NESTED);
        message.put(XAUTO_OP_ACTION, XAUTO_ACTION_SUSPEND);
        message.close(op);
        message.close(ops);
    }
    if (line.ask(message) == 0) wrong(what);
  }

  /// The header's size is not the datagram's. Netlink may say nothing to that: nobody waits.
  void lies() {
    Message message(line.family, XAUTO_CMD_CONTROL, 0);
    const std::uint32_t ops = message.open(XAUTO_A_OPS | NLA_F_NESTED);
    for (std::uint32_t i = 1; i <= 3; ++i) message.op(i, 1 + below(2), some_handle(), 0);
    message.close(ops);
    (void)line.say(message, one_in(2) ? 1 + below(200) : message.size + below(5000),
                   one_in(2) ? 1 + below(message.size) : 0);
  }

  void watchdog() {
    Message message(line.family, XAUTO_CMD_WATCHDOG, NLM_F_ACK);
    const bool off = one_in(6);
    if (off || one_in(2)) message.put(XAUTO_A_TIMEOUT_MS, off ? 0 : 10 + below(200));
    if (line.ask(message) == 0 && off && !privileged) wrong("a user switched its watchdog off");
  }

  void read() {
    if (one_in(2)) {
      (void)line.about(XAUTO_CMD_GET, some_handle());
    } else if (one_in(2)) {
      (void)line.list();
    } else {
      Message message(line.family, XAUTO_CMD_GET, NLM_F_DUMP);
      (void)line.say(message);
      unsigned char some[256];
      (void)recv(line.fd, some, sizeof some, MSG_DONTWAIT);  // and goes away in the middle
      line.hang_up();
      reopen();
    }
  }

  /// With whatever it holds suspended; under the same port at once, at times.
  void close_and_reopen() {
    const std::uint32_t port = line.port();
    line.hang_up();
    reopen(one_in(2) ? port : one_in(2) ? last_port : 0);
    last_port = port;
  }

  /// Says something and does not wait.
  void leave() {
    Message message(line.family, XAUTO_CMD_CONTROL, NLM_F_ACK);
    const std::uint32_t ops = message.open(XAUTO_A_OPS | NLA_F_NESTED);
    for (std::uint32_t i = 1; i <= 4; ++i) message.op(i, 1 + below(2), some_handle(), 0);
    message.close(ops);
    (void)line.say(message);
    line.hang_up();
    reopen();
  }

  void use_gpu() {
    for (const File& file : files) {
      if (file.type != XAUTO_QUEUE_GPU_TSG) continue;
      nvgpu_preemption_mode_args mode{};
      char noise[64] = {};
      int bound = channel;
      switch (below(6)) {
        case 0:
          (void)work(channel, 100 + below(3000));
          break;
        case 1:
          (void)ioctl(channel, NVGPU_IOCTL_CHANNEL_SET_PREEMPTION_MODE, &mode);
          break;
        case 2:
          (void)ioctl(file.fd, NVGPU_TSG_IOCTL_UNBIND_CHANNEL, &bound);
          (void)ioctl(file.fd, NVGPU_TSG_IOCTL_BIND_CHANNEL, &bound);
          break;
        case 3:  // a size or number that there is not
          if (ioctl(file.fd, _IOC(below(4), 'T', below(40), below(64)), noise) == 0) break;
          break;
        case 4:
          (void)ioctl(file.fd, NVGPU_IOCTL_TSG_PREEMPT, 0);
          break;
        default:
          (void)ioctl(file.fd, NVGPU_IOCTL_TSG_SET_TIMESLICE, nullptr);
      }
    }
  }

  void use_dla() {
    for (const File& file : files) {
      if (file.type != XAUTO_QUEUE_DLA) continue;
      nvdla_set_queue_status_args both{NVDLA_SET_QUEUE_SUSPEND | NVDLA_SET_QUEUE_RESUME};
      char noise[64] = {};
      switch (below(4)) {
        case 0:
          (void)task(file.fd, 100 + below(1000));
          break;
        case 1:
          if (ioctl(file.fd, NVDLA_IOCTL_SET_QUEUE_STATUS, &both) == 0)
            wrong("the DLA took both bits");
          break;
        case 2:  // none of them suspends
          (void)ioctl(file.fd, _IOC(below(4), 'D', 11 + below(40), below(64)), noise);
          break;
        default:
          (void)ioctl(file.fd, NVDLA_IOCTL_GET_QUEUE_STATUS, nullptr);
      }
    }
  }

  /// The process that registered dies, a child of its own has the socket.
  void orphan() {
    if (files.empty()) return;
    const File file = files[0];
    const pid_t child = fork();
    if (child == 0) {
      Line own;
      if (!own.open()) _exit(0);
      if (own.take(file.type, file.fd) == 0) (void)own.act(XAUTO_ACTION_SUSPEND, own.handle);
      if (fork() == 0) usleep(below(60000));
      _exit(0);
    }
    if (child > 0) waitpid(child, nullptr, 0);
  }

  /// One suspends while the other takes the claim, or the socket, away.
  void two_threads() {
    const std::uint32_t handle = some_handle();
    const int fd = line.fd;
    Message suspend(line.family, XAUTO_CMD_CONTROL, 0);
    const std::uint32_t ops = suspend.open(XAUTO_A_OPS | NLA_F_NESTED);
    for (std::uint32_t i = 1; i <= 3; ++i) suspend.op(i, 1 + i % 2, handle, 0);
    suspend.close(ops);
    Line other;
    other.fd = dup(fd);
    std::thread helper([&] { (void)other.say(suspend); });
    Message end(line.family, XAUTO_CMD_UNREGISTER, 0);
    end.put(XAUTO_A_HANDLE, handle);
    (void)line.say(end);
    helper.join();
    other.hang_up();
    line.hang_up();
    reopen();
  }

  void unload() {
    // The emulators are in use, always; xauto.ko is root's to unload.
    const char* module = one_in(2) ? "xauto_nvgpu_emu" : "xauto_nvdla_emu";
    if (!privileged && one_in(2)) module = "xauto";
    if (syscall(SYS_delete_module, module, O_NONBLOCK) == 0) wrong("a module in use was unloaded");
  }

  void share() {
    for (const File& file : files) {
      if (file.type != XAUTO_QUEUE_GPU_TSG) continue;
      nvgpu_tsg_get_share_token_args token{1, 1, 0};
      if (ioctl(file.fd, NVGPU_TSG_IOCTL_GET_SHARE_TOKEN, &token) != 0) return;
      nvgpu_gpu_open_tsg_args args{0, NVGPU_GPU_IOCTL_OPEN_TSG_FLAGS_SHARE, 1, token.share_token};
      const int ctrl = open("/dev/nvgpu/igpu0/ctrl", O_RDWR | O_CLOEXEC);
      if (ioctl(ctrl, NVGPU_GPU_IOCTL_OPEN_TSG, &args) == 0) {
        const int twin = static_cast<int>(args.tsg_fd);
        if (line.take(XAUTO_QUEUE_GPU_TSG, twin) == 0) {
          keep();
          (void)line.act(XAUTO_ACTION_SUSPEND, line.handle);
        }
        close(twin);
      }
      close(ctrl);
      return;
    }
  }

  void listen() {
    Line ear;
    if (!ear.open()) return;
    (void)setsockopt(ear.fd, SOL_NETLINK, NETLINK_ADD_MEMBERSHIP, &ear.group, sizeof ear.group);
    (void)line.act(1 + below(2), some_handle());
    unsigned char event[2048];
    (void)recv(ear.fd, event, sizeof event, MSG_DONTWAIT);
    ear.hang_up();
  }

  void tune() {
    (void)line.act(one_in(2) ? XAUTO_ACTION_SET_TIMESLICE : XAUTO_ACTION_SET_INTERLEAVE,
                   some_handle(), one_in(2) ? 1000 + below(50000) : below(4));
  }
  void unregister() {
    if (handles.empty()) return;
    const std::size_t which = below(static_cast<std::uint32_t>(handles.size()));
    (void)line.about(XAUTO_CMD_UNREGISTER, handles[which]);
    handles.erase(handles.begin() + static_cast<std::ptrdiff_t>(which));
  }

  void attack(Kind kind) {
    switch (kind) {
      case kRegister:
        return take_own();
      case kRegisterForeign:
        return take_foreign();
      case kSuspend:
        return check_family(line.act(XAUTO_ACTION_SUSPEND, some_handle()));
      case kResume:
        return check_family(line.act(XAUTO_ACTION_RESUME, some_handle()));
      case kTune:
        return tune();
      case kBatch:
        return batch();
      case kUnregister:
        return unregister();
      case kWrongHandle:
        return wrong_handle();
      case kMalformed:
        return malformed();
      case kLies:
        return lies();
      case kWatchdog:
        return watchdog();
      case kRead:
        return read();
      case kReopen:
        return close_and_reopen();
      case kLeave:
        return leave();
      case kGpu:
        return use_gpu();
      case kDla:
        return use_dla();
      case kNewFile:
        return new_file();
      case kOrphan:
        return orphan();
      case kTwoThreads:
        return two_threads();
      case kUnload:
        return unload();
      case kShare:
        return share();
      case kListen:
        return listen();
      case kKinds:
        return;
    }
  }
};

Kind some_kind() {
  // What is likely to be granted is likely; what forks is rare.
  static const Kind often[] = {kRegister, kRegisterForeign, kSuspend, kSuspend, kSuspend,
                               kResume,   kBatch,           kGpu,     kDla,     kMalformed};
  if (one_in(2)) return often[below(std::size(often))];
  const auto kind = static_cast<Kind>(below(kKinds));
  return (kind == kOrphan || kind == kTwoThreads) && !one_in(6) ? kSuspend : kind;
}

[[noreturn]] void attack(std::uint64_t seed, bool privileged, int tsg, int dla) {
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  random_source.seed(seed);
  if (!privileged) become_user();
  Attacker attacker{privileged, tsg, dla};
  attacker.reopen();
  attacker.new_file();
  for (;;) {
    const Kind kind = some_kind();
    attacker.attack(kind);
    ++shared->kinds[kind];
    ++shared->done;
    while (waitpid(-1, nullptr, WNOHANG) > 0) continue;
  }
}

// --- the emulated drivers' own word -----------------------------------------------------------

std::string slurp(const char* path) {
  std::ifstream file(path);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}
std::string gpu_state() {
  return slurp("/sys/kernel/debug/xauto_nvgpu_emu/state");
}
std::string dla_state(int instance) {
  const std::string text = slurp("/sys/kernel/debug/xauto_nvdla_emu/state");
  const std::size_t second = text.find("dla=1");
  return instance == 0 ? text.substr(0, second) : text.substr(second);
}
int count(const std::string& text, const std::string& part) {
  int found = 0;
  for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1))
    ++found;
  return found;
}
void fault(const char* path, int times) {
  std::ofstream(std::string("/sys/kernel/debug/") + path) << times;
}
/// The limit is generous, since nothing here is about speed.
bool eventually(const std::function<bool()>& condition) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(60);
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    usleep(2000);
  }
  return true;
}

bool load() {
  const int file = open("/modules/xauto.ko", O_RDONLY | O_CLOEXEC);
  const bool loaded = syscall(SYS_finit_module, file, "", 0) == 0;
  close(file);
  return loaded;
}

std::uint64_t number_of(const char* name, std::uint64_t fallback) {
  const char* text = getenv(name);
  return text != nullptr ? strtoull(text, nullptr, 0) : fallback;
}

constexpr const char* kFaults[] = {"xauto_nvgpu_emu/fail_preempt", "xauto_nvgpu_emu/fail_enable",
                                   "xauto_nvdla_emu/fail_suspend"};

struct Field {
  pid_t attackers[kAttackers] = {}, victims[kVictims] = {};
  int tsg, dla;
  long lives = 0, victim_lives = 0, unloads = 0, failed_unloads = 0, faults = 0;

  void start(pid_t& pid, int number, bool victim) {
    const std::uint64_t seed = random_source();
    const bool privileged = seed % 3 != 0;
    ++(victim ? victim_lives : lives);
    pid = fork();
    if (pid < 0) ksft_exit_fail_msg("no more processes\n");
    if (pid == 0) {
      random_source.seed(seed);
      victim ? live(number) : attack(seed, privileged, tsg, dla);
    }
    shared->pids[victim ? kAttackers + number : number] = pid;
  }
  void keep_attackers() {
    for (int i = 0; i < kAttackers; ++i)
      if (attackers[i] == 0 || waitpid(attackers[i], nullptr, WNOHANG) == attackers[i])
        start(attackers[i], i, false);
  }
  void keep_victims() {
    for (int i = 0; i < kVictims; ++i)
      if (victims[i] == 0 || waitpid(victims[i], nullptr, WNOHANG) == victims[i])
        start(victims[i], i, true);
  }
  static void end(pid_t& pid) {
    if (pid <= 0) return;  // killed before, and not started again
    kill(pid, SIGKILL);
    waitpid(pid, nullptr, 0);
    pid = 0;
  }
  /// The module goes under everybody's hands. No driver refuses meanwhile: it has one try.
  void unload() {
    for (const char* name : kFaults) fault(name, 0);
    // A list that is being read holds the module.
    failed_unloads +=
        !eventually([] { return syscall(SYS_delete_module, "xauto", O_NONBLOCK) == 0; });
    failed_unloads += !eventually(load);
    ++unloads;
  }
};

}  // namespace

int main() {
  const auto operations = static_cast<long>(number_of("XAUTO_ATTACK", 2000));
  const std::uint64_t seed = number_of("XAUTO_SEED", 16);
  const long unloads = 2 + operations / 5000;
  setlinebuf(stdout);
  ksft_print_header();
  ksft_set_plan(9);
  random_source.seed(seed);
  shared = static_cast<Shared*>(
      mmap(nullptr, sizeof(Shared), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0));
  // These stay: what must not be reached by a user, and what the work at the end needs.
  int channel = open_channel(0);
  Field field{.tsg = open_tsg(), .dla = open_dla(0)};
  if (field.dla < 0 || ioctl(field.tsg, NVGPU_TSG_IOCTL_BIND_CHANNEL, &channel) != 0)
    ksft_exit_fail_msg("no emulators\n");
  const auto start = std::chrono::steady_clock::now();
  // However fast the machine is: somebody is killed on the way.
  while (shared->done < operations || field.lives <= kAttackers) {
    field.keep_victims();
    field.keep_attackers();
    usleep(below(20000));
    if (one_in(8)) Field::end(field.attackers[below(kAttackers)]);
    if (one_in(60)) Field::end(field.victims[below(kVictims)]);
    // Few: what a context was slow in all its life kills it, and a reload forgets the sum.
    if (one_in(20) && field.faults < 24) {
      fault(kFaults[below(std::size(kFaults))], 1);
      ++field.faults;
    }
    if (field.unloads < unloads && shared->done > (field.unloads + 1) * operations / (unloads + 1))
      field.unload();
  }
  for (pid_t& pid : field.attackers) Field::end(pid);
  for (const char* name : kFaults) fault(name, 0);
  const long seconds =
      std::chrono::duration_cast<std::chrono::seconds>(std::chrono::steady_clock::now() - start)
          .count();
  ksft_print_msg(
      "seed %llu: %ld operations in %ld s, %ld granted, %ld suspensions; %ld attackers, %ld "
      "apps, %ld unloads, %ld faults\n",
      static_cast<unsigned long long>(seed), shared->done.load(), seconds, shared->granted.load(),
      shared->suspends.load(), field.lives, field.victim_lives, field.unloads, field.faults);
  int never = 0;
  for (const auto& times : shared->kinds) never += times == 0;
  ksft_test_result(
      never == 0 && shared->suspends > operations / 50 && field.lives > kAttackers,
      "every kind of operation was made (%d were not), queues suspended and attackers killed\n",
      never);
  ksft_test_result(shared->wrong == 0, "nothing forbidden succeeded (%ld did; first: %s)\n",
                   shared->wrong.load(), shared->wrong != 0 ? shared->first_wrong : "none");
  ksft_test_result(shared->silent == 0 && field.failed_unloads == 0,
                   "every message was answered (%ld were not), every unload done (%ld were not)\n",
                   shared->silent.load(), field.failed_unloads);

  // The apps live on. Nobody has asked the module anything since.
  ksft_test_result(eventually([] {
                     return count(gpu_state(), "enabled=0") == 0 &&
                            count(dla_state(0), "suspended=1") + count(dla_state(0), "stale=1") ==
                                0;
                   }),
                   "no TSG and no queue of DLA 0 is suspended\n");
  ksft_test_result(eventually([] {
                     const std::string state = gpu_state();
                     return count(state, "level=0") == count(state, "tsg=") &&
                            count(state, "timeslice_us=1024 ") == count(state, "tsg=");
                   }),
                   "time slices and interleave levels are the driver's\n");
  // A slot that was released while it was suspended is, for whoever gets it: registering ends that.
  shared->calm = true;
  const bool calm = eventually([&] {
    field.keep_victims();
    return shared->calmed >= kVictims;
  });
  Line line;
  bool registered = line.open();
  for (int i = 0; i < kVictims && registered; ++i) {
    registered = eventually([&] {
      const int copy = descriptor_of(field.victims[i], shared->victim_queues[i]);
      const bool taken = copy >= 0 && line.take(XAUTO_QUEUE_DLA, copy, field.victims[i]) == 0;
      close(copy);
      return taken;
    });
  }
  ksft_test_result(
      calm && registered && eventually([] { return count(dla_state(1), "suspended=1") == 0; }),
      "nor a queue of DLA 1 that somebody registers\n");
  line.hang_up();
  ksft_test_result(work(channel, 1000) && task(field.dla, 1000) && idle(channel, 60000) &&
                       idle(field.dla, 60000),
                   "what was attacked most works\n");

  for (pid_t& pid : field.victims) Field::end(pid);
  for (const int fd : {channel, field.tsg, field.dla}) close(fd);
  ksft_test_result(eventually([] {
                     return count(gpu_state(), "tsg=") == 0 && count(dla_state(0), "queue=") == 0 &&
                            count(dla_state(1), "queue=") == 0;
                   }),
                   "once all are gone no driver has a queue\n");
  ksft_test_result(eventually([] {
                     Line dump;
                     const bool empty = dump.open() && dump.list() == 0 && dump.listed == 0;
                     dump.hang_up();
                     return empty;
                   }),
                   "and the module none\n");
  ksft_finished();
}
