// SPDX-License-Identifier: Apache-2.0
#include "model/grants.h"

#include <cstdlib>
#include <fstream>

#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

namespace xauto {
namespace {

std::string file_of(const std::string& grants) {
  return R"({"schema":"xauto.grants","version":1,"grants":[)" + grants + "]}";
}
Grants read(const std::string& grants) {
  const auto read = parse_grants(file_of(grants), "g");
  EXPECT_TRUE(read) << (read ? "" : read.error().to_string());
  return read ? *read : Grants{};
}
std::string refusal(const std::string& text) {
  const auto read = parse_grants(text, "g");
  return read ? "accepted" : read.error().to_string();
}
Identity alice() {
  return {{1000, "alice"}, {{1000, "alice"}, {44, "video"}}, "/user.slice/user-1000.slice/a.scope"};
}

#define EXPECT_SAYS(text, part) EXPECT_NE((text).find(part), std::string::npos) << (text)

TEST(Grants, GoldenFileIsReadAndWrittenByteForByte) {
  std::ifstream file(std::string(XAUTO_SOURCE_DIR) + "/tests/golden/grants.json");
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  const auto grants = parse_grants(text, "golden");
  ASSERT_TRUE(grants) << grants.error().to_string();
  ASSERT_EQ(grants->grants.size(), 3u);
  EXPECT_EQ(grants->grants[1], (Grant{Grant::To::kGroup, "perception", {10, 60}}));
  EXPECT_EQ(to_json(*grants), text);
}

TEST(Grants, WhatIsNotSaidIsNotGranted) {
  EXPECT_EQ(read("").find(alice()), nullptr);
  EXPECT_EQ(read(R"({"user":"bob","highest":9})").find(alice()), nullptr);
  EXPECT_EQ(read(R"({"user":"video","highest":9})").find(alice()), nullptr) << "a group's name";
  EXPECT_EQ(read(R"({"group":"1001","highest":9})").find(alice()), nullptr);
  EXPECT_EQ(read(R"({"user":"44","highest":9})").find(alice()), nullptr) << "a group's number";
  Identity nameless = alice();
  nameless.user.name.clear();
  nameless.cgroup.clear();
  EXPECT_EQ(read(R"({"user":"alice","highest":9},{"cgroup":"/","highest":9})").find(nameless),
            nullptr);
}

TEST(Grants, UsersAndGroupsAreFoundByNameAndByNumber) {
  for (const char* grant : {R"({"user":"alice","highest":9})", R"({"user":"1000","highest":9})",
                            R"({"group":"video","highest":9})", R"({"group":"44","highest":9})"}) {
    const Grants grants = read(grant);
    const Grant* found = grants.find(alice());
    ASSERT_NE(found, nullptr) << grant;
    EXPECT_EQ(found->range, (FifoRange{1, 9}));
  }
}

TEST(Grants, CgroupCoversWhatIsBelowItAndNoSimilarName) {
  const auto granted = [](const std::string& path) {
    return read(R"({"cgroup":")" + path + R"(","highest":9})").find(alice()) != nullptr;
  };
  EXPECT_TRUE(granted("/"));
  EXPECT_TRUE(granted("/user.slice"));
  EXPECT_TRUE(granted("/user.slice/user-1000.slice/a.scope"));
  EXPECT_FALSE(granted("/user.slice/user-1000.slice/a.scope/b"));
  EXPECT_FALSE(granted("/user.slice/user-100"));
  EXPECT_FALSE(granted("/user"));
}

TEST(Grants, OfSeveralTheHighestHoldsThenTheOneThatReachesLowest) {
  const Grants grants = read(
      R"({"user":"alice","lowest":3,"highest":9},{"group":"video","lowest":5,"highest":20},
         {"cgroup":"/","lowest":2,"highest":20},{"user":"bob","highest":60})");
  EXPECT_EQ(grants.find(alice())->range, (FifoRange{2, 20}));
}

TEST(Grants, WhatIsMisspeltIsRefused) {
  EXPECT_SAYS(refusal(file_of(R"({"user":"a","topmost":9})")), "/grants/0/topmost");
  EXPECT_SAYS(refusal(file_of(R"({"user":"a","topmost":9})")), "is no key of this format");
  EXPECT_SAYS(refusal(R"({"schema":"xauto.grants","version":1,"grants":[],"users":[]})"), "/users");
  EXPECT_SAYS(refusal(file_of(R"({"user":"a","group":"b","highest":9})")), "must name one of");
  EXPECT_SAYS(refusal(file_of(R"({"highest":9})")), "must name one of");
  EXPECT_SAYS(refusal(file_of(R"({"user":"","highest":9})")), "must not be empty");
  EXPECT_SAYS(refusal(file_of(R"({"user":7,"highest":9})")), "must be a string");
  EXPECT_SAYS(refusal(file_of(R"({"user":"a"})")), "key \"highest\" is missing");
  EXPECT_SAYS(refusal(R"({"schema":"xauto.policy","version":1,"grants":[]})"), "/schema");
}

TEST(Grants, RangeIsBounded) {
  EXPECT_SAYS(refusal(file_of(R"({"user":"a","highest":71})")), "from 1 to 70");
  EXPECT_SAYS(refusal(file_of(R"({"user":"a","highest":0})")), "from 1 to 70");
  EXPECT_SAYS(refusal(file_of(R"({"user":"a","highest":9,"lowest":0})")), "from 1 to 70");
  EXPECT_SAYS(refusal(file_of(R"({"user":"a","highest":9,"lowest":10})")), "is above \"highest\"");
  EXPECT_SAYS(refusal(file_of(R"({"user":"a","highest":9.5})")), "must be an integer");
}

TEST(Grants, CgroupPathsAreAbsoluteAndPlain) {
  for (const char* path : {"a", "/a/", "//a", "/a//b", "/a/../b", "/.", "/a/./b", "/.."})
    EXPECT_SAYS(refusal(file_of(R"({"cgroup":")" + std::string(path) + R"(","highest":9})")),
                "is no path of a cgroup");
}

TEST(Grants, FileIsBounded) {
  std::string many;
  for (std::size_t i = 0; i <= kMaxGrants; ++i)
    many += std::string(i == 0 ? "" : ",") + R"({"user":"a","highest":9})";
  EXPECT_SAYS(refusal(file_of(many)), "at most 256");
  EXPECT_SAYS(refusal(file_of("") + std::string(kMaxGrantsBytes, ' ')), "is longer than");
}

TEST(Grants, CgroupIsTheUnifiedHierarchys) {
  EXPECT_EQ(cgroup_of("0::/a/b\n"), "/a/b");
  EXPECT_EQ(cgroup_of("12:cpu:/x\n1:name=systemd:/y\n0::/z\n"), "/z");
  EXPECT_EQ(cgroup_of("12:cpu:/x\n"), "");
  EXPECT_EQ(cgroup_of(""), "");
  EXPECT_EQ(cgroup_of("0::/"), "/");
}

/// A folder of ours with a file in it, judged as if we were the administrator.
class GrantsFile : public ::testing::Test {
 protected:
  void SetUp() override {
    char name[] = "/tmp/xauto-grants-XXXXXX";
    ASSERT_NE(mkdtemp(name), nullptr);
    folder_ = name;
    path_ = folder_ + "/grants.json";
    std::ofstream(path_) << file_of(R"({"user":"alice","highest":9})");
    chmod(path_.c_str(), 0644);
  }
  void TearDown() override {
    unlink(path_.c_str());
    unlink((folder_ + "/real").c_str());
    rmdir(folder_.c_str());
  }
  [[nodiscard]] std::string refusal(uid_t owner = getuid()) const {
    const auto grants = load_grants(path_, owner);
    return grants ? "accepted" : grants.error().to_string();
  }
  std::string folder_, path_;
};

TEST_F(GrantsFile, OfItsOwnerIsRead) {
  EXPECT_EQ(refusal(), "accepted");
}

TEST_F(GrantsFile, ThatOthersCanWriteIsRefused) {
  for (const mode_t mode : {0664u, 0646u, 0666u}) {
    chmod(path_.c_str(), mode);
    EXPECT_SAYS(refusal(), "can be written by others");
    EXPECT_SAYS(refusal(), "grants.json");
  }
}

TEST_F(GrantsFile, InAFolderThatOthersCanWriteIsRefused) {
  chmod(folder_.c_str(), 0777);
  EXPECT_SAYS(refusal(), "can be written by others");
}

TEST_F(GrantsFile, OfAnotherUserIsRefused) {
  EXPECT_SAYS(refusal(getuid() + 1), "belongs to uid");
}

TEST_F(GrantsFile, ThatIsALinkIsRefused) {
  rename(path_.c_str(), (folder_ + "/real").c_str());
  ASSERT_EQ(symlink("real", path_.c_str()), 0);
  EXPECT_SAYS(refusal(), "cannot be opened");
}

TEST_F(GrantsFile, ThatIsNoFileIsRefusedAndDoesNotHang) {
  unlink(path_.c_str());
  ASSERT_EQ(mkfifo(path_.c_str(), 0644), 0);
  EXPECT_SAYS(refusal(), "is not a regular file");
}

TEST_F(GrantsFile, ThatIsMissingIsNotFound) {
  unlink(path_.c_str());
  const auto grants = load_grants(path_, getuid());
  ASSERT_FALSE(grants);
  EXPECT_EQ(grants.error().code, ErrorCode::kNotFound);
}

}  // namespace
}  // namespace xauto
