// SPDX-License-Identifier: Apache-2.0
// The rules of docs/emulation.md, "What is real", case by case.
#include "xpu/presence.h"

#include <gtest/gtest.h>

namespace xauto::xpu {
namespace {

const Hardware kLaptop{.cores = 2, .devices = {}};
const Hardware kOrin{.cores = 4, .devices = {{"gpu", 1}, {"dla", 1}}};

AppSpec app(std::set<std::string, std::less<>> real_on) {
  AppSpec spec;
  spec.name = "a";
  spec.xnodes = {{"x", "M", {{"cpu", 1}, {"gpu", 1}}, {}, std::move(real_on)},
                 {"stand-in", "M", {{"cpu", 1}, {"gpu", 1}, {"dla", 1}}}};
  return spec;
}

/// cpu0..cpu3 gpu0 dla0, a letter each.
std::string of_small(const EmulationFlags& flags, const AppSpec* spec, const Hardware& machine,
                     const Platform& platform = *Platform::builtin("small")) {
  const auto presence = presence_of(platform, flags, spec, machine);
  if (!presence) return presence.error().to_string();
  std::string letters;
  for (const Presence p : *presence) letters += "re?-"[static_cast<int>(p)];
  return letters;
}

TEST(Presence, WithoutFlagsWhatTheMachineLacksIsEmulatedAndTheRestAsTheAppNeedsIt) {
  const AppSpec stand_ins = app({}), computes = app({"cpu"}), both = app({"cpu", "gpu"});
  EXPECT_EQ(of_small({}, &stand_ins, kLaptop), "eeeeee");
  EXPECT_EQ(of_small({}, &computes, kLaptop), "rreeee");
  EXPECT_EQ(of_small({}, &both, kLaptop), "rreeee") << "no app makes a GPU";
  EXPECT_EQ(of_small({}, nullptr, kLaptop), "??eeee") << "profile learns from init";
  EXPECT_EQ(of_small({}, &stand_ins, kOrin), "rrrrrr") << "all is there: nothing is emulated";
  const Hardware no_dla{.cores = 4, .devices = {{"gpu", 1}}};
  EXPECT_EQ(of_small({}, &both, no_dla), "rrrrre");
  EXPECT_EQ(of_small({}, &computes, no_dla), "rrrree");
}

TEST(Presence, FlagsGoBeforeEverything) {
  const AppSpec computes = app({"cpu"}), stand_ins = app({});
  EXPECT_EQ(of_small({.all = true}, &computes, kOrin), "eeeeee");
  EXPECT_EQ(of_small({.names = {"gpu", "dla"}}, &stand_ins, kLaptop), "rr--ee");
  EXPECT_EQ(of_small({.names = {"gpu", "dla"}}, nullptr, kLaptop), "rr--ee");
  EXPECT_EQ(of_small({.names = {"gpu", "cpu3"}}, &computes, kLaptop), "rr-ee-");
  EXPECT_EQ(of_small({.names = {"dla0"}}, &stand_ins, kOrin), "rrrrre");
  EXPECT_NE(of_small({.names = {"tpu"}}, &stand_ins, kOrin).find("'tpu' is no XPU"),
            std::string::npos);
  EXPECT_EQ(of_small({.none = true}, &stand_ins, kOrin), "rrrrrr");
  EXPECT_NE(of_small({.none = true}, &stand_ins, kLaptop).find("cpu2 is not here"),
            std::string::npos);
}

TEST(Presence, ThePlatformFileGoesBeforeWhatTheAppNeeds) {
  Platform platform = *Platform::builtin("small");
  platform.xpus[0].emulated = true;
  platform.xpus[3].emulated = false;
  const AppSpec computes = app({"cpu"}), stand_ins = app({});
  EXPECT_EQ(of_small({}, &computes, kLaptop, platform), "ere-ee");
  EXPECT_EQ(of_small({}, &stand_ins, kOrin, platform), "eeeree");
  EXPECT_EQ(of_small({.all = true}, &computes, kLaptop, platform), "eeeeee");
  EXPECT_EQ(of_small({.names = {"gpu", "dla"}}, &computes, kLaptop, platform), "er--ee");
}

TEST(Presence, OtherTypesAreAlwaysThere) {
  Platform platform{"p", {{"npu0", "npu"}, {"cpu0", "cpu"}}};
  const AppSpec stand_ins = app({});
  EXPECT_EQ(of_small({}, &stand_ins, kLaptop, platform), "rr");
  platform.xpus.push_back({"gpu0", "gpu"});
  EXPECT_EQ(of_small({}, &stand_ins, kLaptop, platform), "eee");
}

TEST(Presence, IsSaidInWords) {
  const Platform small = *Platform::builtin("small");
  const AppSpec computes = app({"cpu"});
  EXPECT_EQ(describe(small, *presence_of(small, {.all = true}, &computes, kLaptop)), "emulated");
  EXPECT_EQ(describe(small, *presence_of(small, {}, &computes, kLaptop)),
            "real: cpu0, cpu1; emulated: cpu2, cpu3, gpu0, dla0");
  EXPECT_EQ(describe(small, *presence_of(small, {}, &computes, kOrin)), "");
}

TEST(Presence, ThePlatformOfAMachineHasNothingThatIsNotThereUnlessEmulated) {
  for (const Hardware& machine : {kLaptop, kOrin}) {
    const Platform here = platform_of(machine, "here");
    ASSERT_TRUE(validate(here));
    EXPECT_EQ(here.instances_of("cpu").size(), machine.cores);
    const AppSpec computes = app({"cpu", "gpu"});
    const auto presence = *presence_of(here, {}, &computes, machine);
    for (std::size_t x = 0; x < presence.size(); ++x)
      EXPECT_EQ(presence[x] == Presence::kReal, machine.has(here, x)) << here.xpus[x].id;
  }
}

}  // namespace
}  // namespace xauto::xpu
