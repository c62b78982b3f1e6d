// SPDX-License-Identifier: Apache-2.0
#include "base/process.h"

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "base/syscalls.h"

extern char** environ;

namespace xauto {
namespace {

/// Those that end a program.
constexpr std::pair<int, const char*> kSignalNames[] = {
    {SIGHUP, "SIGHUP"},   {SIGINT, "SIGINT"},   {SIGQUIT, "SIGQUIT"}, {SIGILL, "SIGILL"},
    {SIGTRAP, "SIGTRAP"}, {SIGABRT, "SIGABRT"}, {SIGBUS, "SIGBUS"},   {SIGFPE, "SIGFPE"},
    {SIGKILL, "SIGKILL"}, {SIGUSR1, "SIGUSR1"}, {SIGSEGV, "SIGSEGV"}, {SIGUSR2, "SIGUSR2"},
    {SIGPIPE, "SIGPIPE"}, {SIGALRM, "SIGALRM"}, {SIGTERM, "SIGTERM"}, {SIGXCPU, "SIGXCPU"},
    {SIGXFSZ, "SIGXFSZ"}, {SIGSYS, "SIGSYS"}};

/// Descriptors first..last, at exec. Before Linux 5.11 (JetPack 5 has 5.10) that cannot be said of many
/// at once: then they are closed now, all but `error_fd`, which says so of itself.
void close_at_exec(unsigned first, unsigned last, int error_fd) {
  if (first > last || syscall(SYS_close_range, first, last, CLOSE_RANGE_CLOEXEC) == 0) return;
  const auto close_now = [](unsigned from, unsigned to) {
    if (from > to || syscall(SYS_close_range, from, to, 0) == 0) return;
    rlimit limit{};
    if (getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
    for (unsigned fd = from; fd <= to && fd < limit.rlim_cur; ++fd) close(static_cast<int>(fd));
  };
  const auto stays = static_cast<unsigned>(error_fd);
  if (stays < first || stays > last) return close_now(first, last);
  if (stays > first) close_now(first, stays - 1);
  if (stays < last) close_now(stays + 1, last);
}

/// In the child, between fork and exec: only async-signal-safe calls.
[[noreturn]] void become(const std::vector<char*>& argv, const std::vector<char*>& environment,
                         const std::vector<int>& keep, pid_t parent, bool own_group, int error_fd) {
  const auto die = [&](int error) {
    [[maybe_unused]] const ssize_t told = write(error_fd, &error, sizeof error);
    _exit(127);
  };
  if (prctl(PR_SET_PDEATHSIG, SIGKILL) != 0) die(errno);
  if (getppid() != parent) _exit(127);  // it died before we asked to be told
  if (own_group) setpgid(0, 0);
  sigset_t none;
  sigemptyset(&none);
  sigprocmask(SIG_SETMASK, &none, nullptr);
  for (const int number : {SIGINT, SIGTERM, SIGPIPE, SIGXFSZ}) ::signal(number, SIG_DFL);
  // `keep` is sorted: close the gaps between what is kept.
  unsigned next = 3;
  for (const int fd : keep) {
    const auto kept = static_cast<unsigned>(fd);
    close_at_exec(next, kept - 1, error_fd);
    if (fcntl(fd, F_SETFD, 0) != 0) die(errno);
    next = kept + 1;
  }
  close_at_exec(next, ~0u, error_fd);
  execvpe(argv[0], argv.data(), environment.data());
  die(errno);
  _exit(127);
}

}  // namespace

void open_standard_streams() {
  // The least number that is free is the next one's.
  for (const int fd : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO})
    if (fcntl(fd, F_GETFD) < 0 && errno == EBADF)
      (void)open("/dev/null", fd == STDIN_FILENO ? O_RDONLY : O_WRONLY);
}

std::string Exit::to_string() const {
  if (unknown) return "an exit status that this program's own waitpid took";
  if (!signalled) return "exit status " + std::to_string(value);
  for (const auto& [number, name] : kSignalNames)
    if (number == value) return std::string("signal ") + name;
  return "signal " + std::to_string(value);
}

Result<Child> Child::spawn(const SpawnOptions& options) {
  if (options.argv.empty()) return fail(ErrorCode::kInternal, "spawn without a program");
  std::vector<std::string> words = options.argv;
  std::vector<std::string> variables;
  for (char** v = environ; *v != nullptr; ++v) {
    const std::string variable = *v;
    const std::string name = variable.substr(0, variable.find('='));
    if (std::none_of(options.environment.begin(), options.environment.end(),
                     [&](const auto& added) { return added.first == name; }))
      variables.push_back(variable);
  }
  for (const auto& [name, value] : options.environment) variables.push_back(name + "=" + value);
  std::vector<char*> argv, environment;
  for (std::string& word : words) argv.push_back(word.data());
  for (std::string& variable : variables) environment.push_back(variable.data());
  argv.push_back(nullptr);
  environment.push_back(nullptr);

  int ends[2];
  if (pipe2(ends, O_CLOEXEC) != 0)
    return fail(ErrorCode::kIo, std::string("pipe: ") + strerror(errno));
  UniqueFd read_end(ends[0]), write_end(ends[1]);
  std::vector<int> keep = options.inherit;
  std::erase_if(keep, [](int fd) { return fd < 3; });
  std::sort(keep.begin(), keep.end());
  const pid_t parent = getpid();
  const pid_t pid = fork();
  if (pid < 0) return fail(ErrorCode::kIo, std::string("fork: ") + strerror(errno));
  if (pid == 0) become(argv, environment, keep, parent, options.own_group, write_end.get());

  write_end.reset();
  Child child;
  child.pid_ = pid;
  child.pidfd_ = UniqueFd(static_cast<int>(syscall(SYS_pidfd_open, pid, 0)));
  int error = 0;
  ssize_t got;
  do {
    got = read(read_end.get(), &error, sizeof error);  // end of file: exec succeeded
  } while (got < 0 && errno == EINTR);
  if (got == sizeof error)
    return fail(error == ENOENT ? ErrorCode::kNotFound : ErrorCode::kIo,
                std::string("cannot start: ") + strerror(error), options.argv.front());
  if (!child.pidfd_) return fail(ErrorCode::kIo, std::string("pidfd_open: ") + strerror(errno));
  return child;
}

Child::Child(Child&& other) noexcept
    : pid_(std::exchange(other.pid_, -1)),
      pidfd_(std::move(other.pidfd_)),
      exit_(std::exchange(other.exit_, std::nullopt)) {}

Child& Child::operator=(Child&& other) noexcept {
  if (this != &other) {
    if (running()) stop(0);
    pid_ = std::exchange(other.pid_, -1);
    pidfd_ = std::move(other.pidfd_);
    exit_ = std::exchange(other.exit_, std::nullopt);
  }
  return *this;
}

Child::~Child() {
  if (running()) stop(0);
}

void Child::signal(int number) const {
  thread_.check();
  // By descriptor: whoever reaps our children for us frees their ids.
  if (running() && pidfd_) syscall(SYS_pidfd_send_signal, pidfd_.get(), number, nullptr, 0);
}

std::optional<Exit> Child::poll() {
  thread_.check();
  return wait(0);
}

std::optional<Exit> Child::wait(int timeout_ms) {
  thread_.check();
  if (exit_ || pid_ <= 0) return exit_;
  pollfd ended{pidfd_.get(), POLLIN, 0};
  if (pidfd_ && ::poll(&ended, 1, timeout_ms) == 0) return std::nullopt;
  int status = 0;
  rusage usage{};
  const pid_t reaped = wait4(pid_, &status, WNOHANG, &usage);
  if (reaped < 0 && errno == ECHILD) {
    exit_ = Exit{.unknown = true};
    return exit_;
  }
  if (reaped != pid_) return std::nullopt;
  const auto us = [](const timeval& t) { return t.tv_sec * 1'000'000 + t.tv_usec; };
  exit_ = WIFSIGNALED(status) ? Exit{true, WTERMSIG(status)} : Exit{false, WEXITSTATUS(status)};
  exit_->cpu_us = us(usage.ru_utime) + us(usage.ru_stime);
  return exit_;
}

Exit Child::stop(int grace_ms) {
  if (pid_ <= 0) return {};
  if (!exit_ && grace_ms > 0) {
    signal(SIGTERM);
    wait(grace_ms);
  }
  if (!exit_) signal(SIGKILL);
  while (!exit_) wait(1000);
  return *exit_;
}

std::string program_directory() {
  char path[4096];
  const ssize_t length = readlink("/proc/self/exe", path, sizeof path);
  const std::string program(path, length > 0 ? static_cast<std::size_t>(length) : 0);
  const std::size_t slash = program.rfind('/');
  // Never the working directory: whoever may write there is not asked what to start.
  return slash == std::string::npos ? "/usr/libexec/xauto" : program.substr(0, slash);
}

}  // namespace xauto
