#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Three nets of torchvision as TorchScript, in half precision, with batches that take about 1, 6 and 40 ms on this GPU:
what nets.cc runs. Their weights are random: what a layer takes does not depend on them.
usage: nets.py FOLDER        writes FOLDER/*.pt and FOLDER/nets.txt, and prints each as JSON"""
import json
import os
import sys

import torch
import torchvision

NETS = (("resnet18", torchvision.models.resnet18, 480, 640, 1.0, 10),
        ("resnet50", torchvision.models.resnet50, 480, 640, 6.0, 40),
        ("deeplabv3_resnet50", torchvision.models.segmentation.deeplabv3_resnet50, 512, 1024, 40.0, 200))


class OneTensor(torch.nn.Module):
    """Of a segmentation net, whose answer is a dictionary."""

    def __init__(self, net):
        super().__init__()
        self.net = net

    def forward(self, x):
        answer = self.net(x)
        return answer["out"] if isinstance(answer, dict) else answer


def took_ms(run, x):
    """Of a graph's replay, as nets.cc launches it: the median of 20."""
    for _ in range(3):
        run(x)
    torch.cuda.synchronize()
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        run(x)
    times = []
    for _ in range(20):
        begin, end = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
        begin.record()
        graph.replay()
        end.record()
        end.synchronize()
        times.append(begin.elapsed_time(end))
    return sorted(times)[10]


def main(folder):
    lines = []
    with torch.inference_mode():
        for name, make, height, width, asked_ms, period_ms in NETS:
            kwargs = {"weights_backbone": None} if "deeplab" in name else {}
            net = OneTensor(make(weights=None, **kwargs)).eval().half().cuda().to(memory_format=torch.channels_last)

            def shaped(batch):
                return torch.rand(batch, 3, height, width, device="cuda", dtype=torch.half).to(
                    memory_format=torch.channels_last)
            some = 4
            batch = max(1, round(some * asked_ms / took_ms(net, shaped(some))))
            path = os.path.join(folder, name + ".pt")
            torch.jit.freeze(torch.jit.trace(net, shaped(batch))).save(path)
            lines.append(f"{path} {batch} {height} {width} {period_ms}")
            print(json.dumps({"net": name, "batch": batch, "height": height, "width": width,
                              "alone_ms": round(took_ms(net, shaped(batch)), 3)}), flush=True)
    with open(os.path.join(folder, "nets.txt"), "w") as file:
        file.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main(sys.argv[1])
