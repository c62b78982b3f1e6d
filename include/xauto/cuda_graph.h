// SPDX-License-Identifier: Apache-2.0
// A CUDA graph as an XNode's work: captured once, launched with one call per job, on the level that the job needs. Only
// for apps that have CUDA 11.4 or newer (cuda.h, libcuda). Run on an H200 with CUDA 13: bench/nvidia/nets.cc.
#pragma once

#include <memory>
#include <utility>

#include <xauto/cuda.h>

namespace xauto::cuda {

/// Captured work. Threads: one at a time. The Context must outlive it.
class Graph {
 public:
  /// Records what `work(stream)` queues, and runs nothing of it: kernels, copies, library calls that take a stream.
  /// Memory that it names must stay where it is. Errors: what `work` returns; kUnavailable, with CUDA's words, as of
  /// work that cannot be captured (it waits, or uses another stream).
  template <class Work>
  [[nodiscard]] static Result<std::unique_ptr<Graph>> capture(const Context& context, Work work) {
    std::unique_ptr<Graph> made(new Graph(context));
    const Context::Scope scope(context);
    XAUTO_TRY(scope.entered());
    // Kernels keep the priority of the stream that they are captured on only if instantiation asks for that
    // (CUDA_GRAPH_INSTANTIATE_FLAG_USE_NODE_PRIORITY). It does not: they have that of the stream they are launched on.
    XAUTO_TRY(checked(cuStreamBeginCapture(context.stream(), CU_STREAM_CAPTURE_MODE_THREAD_LOCAL),
                      "cuStreamBeginCapture"));
    const Status queued = work(context.stream());
    CUgraph graph = nullptr;
    const Status ended =
        checked(cuStreamEndCapture(context.stream(), &graph), "cuStreamEndCapture");
    Status done = queued ? ended : queued;
    if (done)
      done = checked(cuGraphInstantiateWithFlags(&made->graph_, graph, 0),
                     "cuGraphInstantiateWithFlags");
    if (graph != nullptr) cuGraphDestroy(graph);
    if (!done) return tl::unexpected<Error>(std::move(done).error());
    return made;
  }
  Graph(const Graph&) = delete;
  Graph& operator=(const Graph&) = delete;
  ~Graph() {
    if (graph_ == nullptr) return;
    const Context::Scope scope(context_);
    cuGraphExecDestroy(graph_);
  }

  /// Queues all of it on `stream`, with more of the same job's behind it perhaps: the context must be current (Scope).
  /// Error: kUnavailable.
  [[nodiscard]] Status launch(CUstream stream) {
    return checked(cuGraphLaunch(graph_, stream), "cuGraphLaunch");
  }
  /// Runs all of it on the context's stream, and waits for it: an `exec`. Error: kUnavailable.
  [[nodiscard]] Status run() {
    const Context::Scope scope(context_);
    XAUTO_TRY(scope.entered());
    XAUTO_TRY(launch(context_.stream()));
    return context_.synchronize();
  }

 private:
  explicit Graph(const Context& context) : context_(context) {}
  const Context& context_;
  CUgraphExec graph_ = nullptr;
};

}  // namespace xauto::cuda
