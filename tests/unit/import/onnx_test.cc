// SPDX-License-Identifier: Apache-2.0
// Nets that are cut: all graphs of few nodes against brute force; what hostile ones may hold.
#include <algorithm>
#include <functional>
#include <numeric>
#include <random>
#include <set>

#include <gtest/gtest.h>

#include "model/json.h"

#include "import/onnx.pb.h"
#include "import/onnx_net.h"

namespace xauto::import {
namespace {

namespace pb = onnx_file;

std::string letter(int n) {
  return std::string(1, static_cast<char>('a' + n));
}

/// A net of `n` nodes with these edges (u before v), written in this order. Who has no predecessor takes the input, who has
/// no successor makes an output.
pb::Model net_of(int n, const std::vector<std::pair<int, int>>& edges,
                 const std::vector<int>& order) {
  pb::Model model;
  pb::Graph& graph = *model.mutable_graph();
  const auto typed = [](pb::ValueInfo& info, const std::string& name) {
    info.set_name(name);
    info.mutable_type()->mutable_tensor_type()->set_elem_type(1);
  };
  typed(*graph.add_input(), "x");
  for (const int v : order) {
    pb::Node& node = *graph.add_node();
    node.set_name("node_" + letter(v));
    node.set_op_type("Sum");
    for (const auto& [from, to] : edges)
      if (to == v) node.add_input(letter(from));
    if (node.input_size() == 0) node.add_input("x");
    node.add_output(letter(v));
    if (std::ranges::none_of(edges, [&](const auto& e) { return e.first == v; }))
      typed(*graph.add_output(), letter(v));
  }
  (void)n;
  return model;
}

Result<OnnxNet> parsed(const pb::Model& model) {
  return OnnxNet::parse(model.SerializeAsString(), "net");
}

/// Each graph of up to `most` nodes in its topological orders; of the largest only each `every`-th of these, the first among
/// them.
void each_net(int most, int every,
              const std::function<void(int, const std::vector<std::pair<int, int>>&,
                                       const std::vector<int>&)>& take) {
  for (int n = 1; n <= most; ++n) {
    std::vector<std::pair<int, int>> all;
    for (int u = 0; u < n; ++u)
      for (int v = u + 1; v < n; ++v) all.emplace_back(u, v);
    for (unsigned chosen = 0; chosen < 1u << all.size(); ++chosen) {
      std::vector<std::pair<int, int>> edges;
      for (std::size_t e = 0; e < all.size(); ++e)
        if (chosen >> e & 1u) edges.push_back(all[e]);
      std::vector<int> order(static_cast<std::size_t>(n));
      std::iota(order.begin(), order.end(), 0);
      int orders = 0;
      do {
        std::vector<int> place(order.size());
        for (std::size_t i = 0; i < order.size(); ++i)
          place[static_cast<std::size_t>(order[i])] = static_cast<int>(i);
        const bool topological = std::ranges::all_of(edges, [&](const auto& e) {
          return place[static_cast<std::size_t>(e.first)] <
                 place[static_cast<std::size_t>(e.second)];
        });
        if (topological && (n < most || orders++ % every == 0)) take(n, edges, order);
      } while (std::ranges::next_permutation(order).found);
    }
  }
}

/// Whether every way from the input to an output goes through p: by going all of them.
bool all_ways_through(int n, const std::vector<std::pair<int, int>>& edges, int p) {
  const std::function<bool(int)> ways = [&](int v) {
    if (v == p) return true;
    bool any = false, through = true;
    for (const auto& [from, to] : edges)
      if (from == v) {
        any = true;
        through = through && ways(to);
      }
    return any && through;
  };
  for (int v = 0; v < n; ++v)
    if (std::ranges::none_of(edges, [&](const auto& e) { return e.second == v; }) && !ways(v))
      return false;
  return true;
}

TEST(OnnxNet, CutsOfAllGraphsOfFiveNodesAreThoseOfBruteForce) {
  std::size_t nets = 0, single = 0;
  each_net(5, 5, [&](int n, const auto& edges, const auto& order) {
    const auto net = parsed(net_of(n, edges, order));
    ASSERT_TRUE(net) << net.error().to_string();
    ++nets;
    const auto used_at_or_behind = [&](int u, std::size_t place) {
      return std::any_of(
          order.begin() + static_cast<std::ptrdiff_t>(place), order.end(),
          [&](int v) { return std::ranges::find(edges, std::pair(u, v)) != edges.end(); });
    };
    for (std::size_t most = 1; most <= 3; ++most) {
      std::vector<std::pair<std::size_t, std::vector<std::string>>> expected, found;
      for (std::size_t place = 1; place < order.size(); ++place) {
        std::vector<std::string> crossing;
        for (std::size_t i = 0; i < place; ++i)
          if (used_at_or_behind(order[i], place)) crossing.push_back(letter(order[i]));
        if (crossing.size() <= most) expected.emplace_back(place, crossing);
      }
      for (const OnnxCut& cut : net->cuts(most)) found.emplace_back(cut.after, cut.tensors);
      ASSERT_EQ(found, expected);
    }
    // The theorem: whatever the order, behind what all ways go through one tensor crosses.
    for (int p = 0; p < n; ++p) {
      if (order.back() == p || !all_ways_through(n, edges, p)) continue;
      const OnnxCut* cut = net->cut_behind(letter(p));
      ASSERT_NE(cut, nullptr);
      ASSERT_EQ(cut->tensors, std::vector<std::string>{letter(p)});
      ++single;
    }
  });
  EXPECT_GT(nets, 2000u);
  EXPECT_GT(single, 400u);
}

TEST(OnnxNet, PartsOfAllGraphsOfFourNodesAreNetsThatMakeTheWhole) {
  each_net(4, 4, [&](int n, const auto& edges, const auto& order) {
    const auto net = parsed(net_of(n, edges, order));
    ASSERT_TRUE(net);
    const std::vector<OnnxCut> all = net->cuts(64);
    ASSERT_EQ(all.size() + 1, static_cast<std::size_t>(n));
    for (unsigned chosen = 0; chosen < 1u << all.size(); ++chosen) {
      std::vector<OnnxCut> at;
      for (std::size_t c = 0; c < all.size(); ++c)
        if (chosen >> c & 1u) at.push_back(all[c]);
      const std::vector<OnnxPart> parts = net->parts(at);
      ASSERT_EQ(parts.size(), at.size() + 1);
      std::set<std::string> there = {"x"};
      std::vector<std::string> nodes;
      for (const OnnxPart& part : parts) {
        const auto again = OnnxNet::parse(part.model, "part");
        ASSERT_TRUE(again) << again.error().to_string();
        EXPECT_EQ(again->nodes(), part.nodes);
        for (const std::string& name : part.inputs) EXPECT_TRUE(there.contains(name)) << name;
        there.insert(part.outputs.begin(), part.outputs.end());
        nodes.insert(nodes.end(), part.nodes.begin(), part.nodes.end());
      }
      EXPECT_EQ(nodes, net->nodes());
      for (int v = 0; v < n; ++v) {
        const bool output =
            std::ranges::none_of(edges, [&](const auto& e) { return e.first == v; });
        EXPECT_TRUE(!output || there.contains(letter(v)));
      }
    }
  });
}

pb::Model chain(int n) {
  std::vector<std::pair<int, int>> edges;
  std::vector<int> order;
  for (int v = 0; v < n; ++v) {
    order.push_back(v);
    if (v > 0) edges.emplace_back(v - 1, v);
  }
  return net_of(n, edges, order);
}

TEST(OnnxNet, ConstantsAndInitializersGoWhereTheyAreUsed) {
  pb::Model model = chain(3);
  pb::Graph& graph = *model.mutable_graph();
  graph.add_initializer()->set_name("w");
  graph.mutable_initializer(0)->set_data_type(1);
  // c = Constant(); d = Mul(c, w): first in the file, used by the last two.
  pb::Graph ordered;
  pb::Node& c = *ordered.add_node();
  c.set_op_type("Constant");
  c.add_output("C");
  pb::Node& d = *ordered.add_node();
  d.set_op_type("Mul");
  d.add_input("C");
  d.add_input("w");
  d.add_output("D");
  for (const auto& node : graph.node()) *ordered.add_node() = node;
  ordered.mutable_node(3)->add_input("D");
  ordered.mutable_node(4)->add_input("D");
  *graph.mutable_node() = ordered.node();
  const auto net = parsed(model);
  ASSERT_TRUE(net) << net.error().to_string();
  EXPECT_EQ(net->nodes().size(), 3u);
  ASSERT_EQ(net->cuts(1).size(), 2u);
  std::vector<std::vector<int>> counts;
  for (const OnnxPart& part : net->parts(net->cuts(1))) {
    pb::Model file;
    ASSERT_TRUE(file.ParseFromString(part.model));
    counts.push_back({file.graph().node_size(), file.graph().initializer_size()});
  }
  EXPECT_EQ(counts, (std::vector<std::vector<int>>{{1, 0}, {3, 1}, {3, 1}}));
}

TEST(OnnxNet, WhatSubgraphsCaptureCrosses) {
  pb::Model model = chain(3);
  pb::Node& last = *model.mutable_graph()->mutable_node(2);
  last.set_op_type("If");
  pb::Attribute& branch = *last.add_attribute();
  branch.set_name("then_branch");
  pb::Graph& inner = *branch.mutable_g();
  pb::Node& inside = *inner.add_node();
  inside.set_op_type("Sum");
  inside.add_input("a");  // of the graph around it
  inside.add_input("own");
  inside.add_output("made");
  inner.add_initializer()->set_name("own");
  inner.add_output()->set_name("made");
  const auto net = parsed(model);
  ASSERT_TRUE(net) << net.error().to_string();
  EXPECT_EQ(net->cut_behind("b")->tensors, (std::vector<std::string>{"a", "b"}));
  EXPECT_EQ(net->cuts(1).size(), 1u);
  inside.set_input(0, "nobody");
  EXPECT_FALSE(parsed(model));
}

TEST(OnnxNet, WhatIsUnknownGoesThrough) {
  pb::Model model = chain(2);
  const std::string later = "\xa2\x06\x03new";  // field 100
  std::string bytes = model.SerializeAsString() + later;
  const auto net = OnnxNet::parse(bytes, "net");
  ASSERT_TRUE(net);
  for (const OnnxPart& part : net->parts(net->cuts(1)))
    EXPECT_NE(part.model.find(later), std::string::npos);
}

TEST(OnnxNet, CirclesAndWhatIsMissingAreRefused) {
  const auto refused = [](const std::function<void(pb::Graph&)>& change, const char* says) {
    pb::Model model = chain(3);
    change(*model.mutable_graph());
    const auto net = parsed(model);
    ASSERT_FALSE(net) << says;
    EXPECT_NE(net.error().what.find(says), std::string::npos) << net.error().what;
  };
  refused([](pb::Graph& g) { g.mutable_node(0)->add_input("c"); }, "nothing before it makes");
  refused([](pb::Graph& g) { g.mutable_node(1)->set_input(0, "nobody"); },
          "nothing before it makes");
  refused([](pb::Graph& g) { g.mutable_node(1)->set_output(0, "a"); }, "there already");
  refused([](pb::Graph& g) { g.mutable_node(1)->set_output(0, "x"); }, "there already");
  refused([](pb::Graph& g) { g.mutable_node(1)->add_output("b"); }, "twice");
  refused([](pb::Graph& g) { g.mutable_output(0)->set_name("nobody"); }, "made by no node");
  refused([](pb::Graph& g) { g.clear_node(); }, "no ONNX model");
  EXPECT_FALSE(OnnxNet::parse("", "net"));
  EXPECT_FALSE(OnnxNet::parse("no model", "net"));
}

TEST(OnnxNet, ATensorOfUnknownTypeIsNoCut) {
  pb::Model model = chain(3);
  model.mutable_graph()->mutable_node(0)->set_op_type("MyOwn");
  const auto net = parsed(model);
  ASSERT_TRUE(net);
  EXPECT_EQ(net->untyped(), 1u + 1u) << "and what is made of it has no type either";
  model.mutable_graph()->mutable_node(1)->set_op_type("Shape");
  EXPECT_EQ(parsed(model)->cuts(1).size(), 1u);
}

TEST(OnnxNet, FilesOutsideItsFolderAreRefused) {
  for (const char* place : {"/etc/passwd", "../weights", "a/../../b", ""}) {
    pb::Model model = chain(2);
    pb::Tensor& tensor = *model.mutable_graph()->add_initializer();
    tensor.set_name("w");
    tensor.set_data_location(1);
    tensor.add_external_data()->set_key("location");
    tensor.mutable_external_data(0)->set_value(place);
    EXPECT_FALSE(parsed(model)->external_files()) << place;
    tensor.mutable_external_data(0)->set_value("weights.bin");
    EXPECT_EQ(*parsed(model)->external_files(), std::vector<std::string>{"weights.bin"});
  }
}

TEST(OnnxNet, LayersNameNodesAndAreNotCut) {
  const auto net = parsed(chain(5));
  ASSERT_TRUE(net);
  const std::vector<EngineLayer> layers = {
      {"Reformatting CopyNode for Input Tensor 0 to node_a + node_b", 1},
      {"node_a + node_b", 10},
      {"copy", 2},
      {"{ForeignNode[node_c...node_d]}", 30},
      {"node_e", 5}};
  const auto times = times_of_nodes(*net, "gpu", layers, "f");
  ASSERT_TRUE(times) << times.error().to_string();
  EXPECT_EQ(times->us, (std::vector<double>{0, 13, 0, 30, 5}));
  EXPECT_EQ(times->fused, (std::vector<bool>{true, false, true, false, false}));
  EXPECT_NEAR(times->unnamed, 3.0 / 48, 1e-9);
  EXPECT_FALSE(times_of_nodes(*net, "gpu", {{"other", 1}}, "f"));
  const ImportedApp app = app_of_parts("net", 5, {net->cuts()[1], net->cuts()[3]}, {*times}, 50);
  ASSERT_EQ(app.app.xnodes.size(), 3u);
  EXPECT_EQ(app.app.xnodes[1].wcet_us.at("gpu"), 45);
  EXPECT_TRUE(parse_imported(to_json(app), "again"));
}

TEST(OnnxNet, EvenCutsHaveTheShortestLongestPart) {
  std::mt19937 random(2);
  for (int world = 0; world < 300; ++world) {
    const int n = 2 + static_cast<int>(random() % 9);
    const auto net = parsed(chain(n));
    LayerTimes times{"gpu", {}, std::vector<bool>(static_cast<std::size_t>(n), false), 0};
    for (int v = 0; v < n; ++v) times.us.push_back(static_cast<double>(random() % 20));
    times.us[0] += 1;
    const auto longest = [&](const std::vector<std::size_t>& at) {
      double most = 0;
      std::size_t from = 0;
      for (std::size_t c = 0; c <= at.size(); ++c) {
        const std::size_t to = c < at.size() ? at[c] : static_cast<std::size_t>(n);
        most = std::max(most,
                        std::accumulate(times.us.begin() + static_cast<std::ptrdiff_t>(from),
                                        times.us.begin() + static_cast<std::ptrdiff_t>(to), 0.0));
        from = to;
      }
      return most;
    };
    const std::size_t count = 1 + random() % 4;
    double least = 1e9;
    for (unsigned chosen = 0; chosen < 1u << (n - 1); ++chosen) {
      std::vector<std::size_t> at;
      for (int c = 0; c < n - 1; ++c)
        if (chosen >> c & 1u) at.push_back(static_cast<std::size_t>(c) + 1);
      if (at.size() <= count) least = std::min(least, longest(at));
    }
    std::vector<std::size_t> found;
    for (const OnnxCut& cut : even_cuts(*net, net->cuts(1), {times}, count))
      found.push_back(cut.after);
    EXPECT_EQ(found.size(), std::min<std::size_t>(count, static_cast<std::size_t>(n) - 1));
    EXPECT_NEAR(longest(found), least, 1e-6);
  }
}

}  // namespace
}  // namespace xauto::import
