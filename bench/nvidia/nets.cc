// SPDX-License-Identifier: Apache-2.0
// Real nets on an NVIDIA GPU: TorchScript files that nets.py has made, each a module with a source of its own, captured
// as a CUDA graph and launched on the stream of its job. The most urgent is the first.
//
//   NETS=nets.txt nets        lines of FILE.pt BATCH HEIGHT WIDTH PERIOD_MS
#include <chrono>
#include <fstream>
#include <memory>
#include <string>
#include <vector>

#include <ATen/cuda/CUDAContext.h>
#include <ATen/cuda/CUDAGraph.h>
#include <c10/cuda/CUDACachingAllocator.h>
#include <c10/cuda/CUDAGuard.h>
#include <torch/script.h>

#include <xauto/cuda_graph.h>

#include "stage.h"

namespace {

struct Net {
  std::string file;
  int batch = 0, height = 0, width = 0, period_ms = 0;
};

/// A net on its place. Torch knows no context but the GPU's own: by levels, by hand or by nobody.
class Inference {
 public:
  Inference(const xauto::XpuId& xpu, const Net& net, int by_hand) : place_(xpu, by_hand) {
    const nvidia::Context::Scope scope(place_.context());
    const c10::InferenceMode inference;
    const auto device = static_cast<c10::DeviceIndex>(xpu.index);
    (void)at::zeros(
        {1}, c10::Device(c10::kCUDA, device));  // it sets up what it needs with its first tensor
    // Memory of its own, since the graph's must stay where it is.
    const auto pool = at::cuda::graph_pool_handle();
    c10::cuda::CUDACachingAllocator::beginAllocateToPool(device, pool,
                                                         [](cudaStream_t) { return true; });
    torch::jit::Module module = torch::jit::load(net.file, c10::Device(c10::kCUDA, device));
    const at::Tensor input =
        at::rand({net.batch, 3, net.height, net.width},
                 at::TensorOptions().device(c10::kCUDA, device).dtype(at::kHalf))
            .contiguous(at::MemoryFormat::ChannelsLast);
    const auto infer = [&](CUstream stream) {
      const c10::cuda::CUDAStreamGuard on(c10::cuda::getStreamFromExternal(stream, device));
      output_ = module.forward({input});
      return xauto::Status();
    };
    for (int i = 0; i < 5; ++i)
      (void)infer(place_.stream());  // the compiler's and cuDNN's first looks
    nvidia::must(cuCtxSynchronize(), "cuCtxSynchronize");
    auto graph = xauto::cuda::Graph::capture(place_.context(), infer);
    c10::cuda::CUDACachingAllocator::endAllocateToPool(device, pool);
    if (!graph) throw std::runtime_error(graph.error().to_string());
    graph_ = std::move(graph.value());
    module_ = std::move(module);
    input_ = input;
  }
  [[nodiscard]] xauto::SchedHandle handle() const { return place_.handle(); }
  xauto::Status run() {
    const nvidia::Context::Scope scope(place_.context());
    XAUTO_TRY(scope.entered());
    XAUTO_TRY(graph_->launch(place_.stream()));
    return place_.synchronize();
  }

 private:
  nvidia::Place place_;
  torch::jit::Module module_;
  at::Tensor input_;
  c10::IValue output_;
  std::unique_ptr<xauto::cuda::Graph> graph_;
};

struct State {
  int done = 0;
};

void add(xauto::App& app, const std::string& name, const Net& net, int by_hand) {
  xauto::XNode<State> node(name + ".run");
  node.add_impl(
      xauto::XPU::GPU,
      [net, by_hand](const xauto::XpuId& xpu) {
        auto inference = std::make_unique<Inference>(xpu, net, by_hand);
        const xauto::SchedHandle handle = inference->handle();
        return xauto::own(std::move(inference), handle);
      },
      [](Inference& inference, State& state, const xauto::Input&) {
        ++state.done;
        return inference.run();
      });
  nvidia::add_module(app, name, std::chrono::milliseconds(net.period_ms), node);
}

}  // namespace

int main(int argc, char** argv) {
  const char* path = std::getenv("NETS");
  std::ifstream file(path != nullptr ? path : "nets.txt");
  std::vector<Net> nets;
  for (Net net; file >> net.file >> net.batch >> net.height >> net.width >> net.period_ms;)
    nets.push_back(net);
  xauto::App app("nets");
  for (std::size_t i = 0; i < nets.size(); ++i)
    add(app, "net" + std::to_string(i), nets[i], static_cast<int>(nets.size() - 1 - i));
  return app.main(argc, argv);
}
