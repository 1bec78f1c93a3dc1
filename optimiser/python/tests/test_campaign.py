"""Campaigns on a real Ray cluster of several nodes on this machine, some of which are killed."""

import importlib.util
import json
import os
import secrets
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from powderline import cluster
from powderline.campaign import Campaign, ClusterError

if importlib.util.find_spec("ray") is None:
    pytest.skip("there is no Ray", allow_module_level=True)

ROLLOUTS = """
name = "few"
benches = ["tiny.toml"]
amounts_kg = [0.0008, 0.0016]
seeds = {{ first = 1, count = {seeds} }}
theta = [0.3, 0.0, 0.0, 0.0, 0.3]

[[powder]]
name = "heavy"
density_kg_m3 = 1500.0

[[powder]]
name = "steep"
friction_angle_deg = 38.0
"""
SEARCHES = 'name = "searches"\nbenches = ["tiny.toml"]\nseeds = [1, 2]\nepochs = 1\nrefine = false\nreplays = false\n'


# What is started here, and nobody else, may use the clusters; and a machine that is busy takes its time.
os.environ.update(RAY_AUTH_MODE="token", RAY_AUTH_TOKEN=secrets.token_hex(32), RAY_raylet_start_wait_time_s="200")

PORTS = ["dashboard-agent-grpc-port", "dashboard-agent-listen-port", "metrics-export-port", "runtime-env-agent-port"]


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as server:
        return server.getsockname()[1]


class Nodes:
    """A Ray cluster whose nodes can be killed: `ray start`, and what it leaves running."""

    def __init__(self):
        self.processes = {}
        self.address = None
        self.ray = str(Path(sys.executable).with_name("ray"))

    def start(self, name, *, cpus=1, tries=3):
        place = ["--head", "--port=0"] if self.address is None else [f"--address={self.address}"]
        before = set(ray_processes())
        said = subprocess.run(
            [self.ray, "start", *place, f"--num-cpus={cpus}", "--memory=4294967296", "--object-store-memory=100000000"]
            + ["--include-dashboard=false"] * (self.address is None)
            # Ray waits a quarter of a minute, and no more, for what is to choose these by itself.
            + [f"--{port}={free_port()}" for port in PORTS]
            + ["--disable-usage-stats"],
            capture_output=True,
            text=True,
        )
        self.processes[name] = sorted(set(ray_processes()) - before)
        if said.returncode != 0:
            # On a machine that is too busy it gives up all the same.
            self.kill(name)
            assert tries > 1, said.stdout + said.stderr
            return self.start(name, cpus=cpus, tries=tries - 1)
        if self.address is None:
            self.address = said.stdout.split("--address='")[1].split("'")[0]

    def kill(self, name):
        for process in self.processes.pop(name, []):
            try:
                os.kill(process, signal.SIGKILL)
            except ProcessLookupError:
                pass

    def end(self):
        for name in list(self.processes):
            self.kill(name)


def ray_processes():
    """Those that make up nodes, not their workers, which go with them."""
    for entry in Path("/proc").iterdir():
        try:
            words = (entry / "cmdline").read_bytes() if entry.name.isdigit() else b""
        except OSError:
            continue
        if any(name in words for name in (b"/raylet/raylet", b"/gcs/gcs_server", b"ray/_private/log_monitor", b"monitor.py")):
            yield int(entry.name)


@pytest.fixture(scope="module")
def bench(scene, tmp_path_factory):
    folder = tmp_path_factory.mktemp("campaign")
    (folder / "tiny.toml").write_text(scene.to_toml())
    return folder


@pytest.fixture(scope="module")
def nodes():
    nodes = Nodes()
    try:
        nodes.start("head")
        nodes.start("second")
        yield nodes
    finally:
        nodes.end()


def campaign(bench, text, name="campaign"):
    path = bench / f"{name}.toml"
    path.write_text(text)
    return path


def alone(path, out):
    """What the program makes of it on this machine: the bytes of its table."""
    command = [sys.executable, "-m", "powderline", "campaign", str(path), "--out", str(out)]
    subprocess.run(command, capture_output=True)
    return (out / "table.parquet").read_bytes()


def program(*arguments, module="campaign", **environment):
    command = [sys.executable, "-m", f"powderline.{module}", *map(str, arguments)]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ, **environment}
    )


def done(folder):
    """When each case came to its outcome."""
    found = {}
    for outcome in Path(folder).glob("cases/*/outcome.json"):
        if not outcome.parent.name.startswith("."):
            found[outcome.parent.name] = outcome.stat().st_mtime_ns
    return found


def wait_for(count, folder):
    began = time.monotonic()
    while len(done(folder)) < count:
        assert time.monotonic() - began < 240.0, f"nothing comes of {folder}"
        time.sleep(0.05)


def test_a_cluster_makes_the_bytes_that_one_machine_makes(bench, nodes, tmp_path, capsys):
    path = campaign(bench, ROLLOUTS.format(seeds=2))
    result = Campaign.load(path).run(tmp_path / "ray", address=nodes.address)
    said = capsys.readouterr().err
    assert "2 nodes with 2 CPUs: 2 cases at a time" in said and "[8/8] " in said
    whole = alone(path, tmp_path / "alone")
    assert (tmp_path / "ray" / "table.parquet").read_bytes() == whole
    assert (tmp_path / "ray" / "report.html").read_bytes() == (tmp_path / "alone" / "report.html").read_bytes()
    assert result.exit_code == 0 and result.verdict == "Of 8 cases, 8 are simulated."
    assert [row["case"] for row in result.cases] == [row["case"] for row in Campaign.load(path).cases]
    assert {row["status"] for row in result.cases} == {"done"}
    result.show(2)
    assert "and 6 more" in capsys.readouterr().out
    # It is done: nothing is done again, and with one seed more only that, by whichever program.
    before = done(tmp_path / "ray")
    Campaign.load(tmp_path / "ray").run(tmp_path / "ray", resume=True, address=nodes.address)
    assert "are done" in capsys.readouterr().err and done(tmp_path / "ray") == before
    more = campaign(bench, ROLLOUTS.format(seeds=3), "more")
    Campaign.load(more).run(tmp_path / "ray", resume=True, address=nodes.address)
    assert "8 are done already" in capsys.readouterr().err
    after = done(tmp_path / "ray")
    assert len(after) == 12 and all(after[case] == when for case, when in before.items())
    subprocess.run([sys.executable, "-m", "powderline", "campaign", more, "--resume", tmp_path / "alone"], check=True)
    assert (tmp_path / "ray" / "table.parquet").read_bytes() == (tmp_path / "alone" / "table.parquet").read_bytes()


def test_each_search_is_a_run_like_any_other_and_goes_to_any_address(bench, nodes, tmp_path):
    path = campaign(bench, SEARCHES)
    result = Campaign.load(path).run(tmp_path / "ray", address=nodes.address, verbose=False)
    assert (tmp_path / "ray" / "table.parquet").read_bytes() == alone(path, tmp_path / "alone")
    address = f"file://{tmp_path}/there"
    there = Campaign.load(path).run(address, address=nodes.address, verbose=False)
    assert [row["plan"] for row in there.cases] == [row["plan"] for row in result.cases]
    for folder in ("ray", "there"):
        for file in ("table.parquet", "cases/tiny_seed2/skill.plan", "cases/tiny_seed2/scene.toml"):
            assert (tmp_path / folder / file).read_bytes() == (tmp_path / "alone" / file).read_bytes(), file
        assert (tmp_path / folder / "cases" / "tiny_seed1" / "report.html").exists()
    plan = result.plan("tiny_seed1")
    assert there.plan("tiny_seed1").to_bytes() == plan.to_bytes()
    # Its scene lies beside it, here as there.
    assert plan.scene == there.plan("tiny_seed1").scene is not None and plan.met is not None
    with pytest.raises(ValueError, match="already holds a campaign"):
        Campaign.load(path).run(address, address=nodes.address, verbose=False)
    before = done(tmp_path / "there")
    again = Campaign.load(address).run(address, resume=True, address=nodes.address, verbose=False)
    assert done(tmp_path / "there") == before and again.verdict == there.verdict


def test_nodes_drivers_and_heads_that_are_killed_lose_nothing(bench, tmp_path):
    path = campaign(bench, ROLLOUTS.format(seeds=20))
    whole = alone(path, tmp_path / "alone")
    nodes = Nodes()
    try:
        nodes.start("head")
        nodes.start("second")
        out = tmp_path / "ray"
        # A node.
        driver = program(path, "--out", out, "--address", nodes.address)
        wait_for(5, out)
        nodes.kill("second")
        wait_for(len(done(out)) + 2, out)
        # The driver; another goes on.
        driver.kill()
        driver.communicate()
        before = done(out)
        nodes.start("third")
        driver = program("--resume", out, "--address", nodes.address, RAY_gcs_rpc_server_reconnect_timeout_s="5")
        wait_for(len(before) + 3, out)
        # The head, and with it the cluster.
        nodes.end()
        said = driver.communicate(timeout=240)[1]
        assert driver.returncode == 1, said
        last = said.splitlines()[-1]
        assert f"the Ray cluster at {nodes.address} is gone" in last and f"--resume {out}" in last
        between = done(out)
        assert all(between[case] == when for case, when in before.items()), "something was done twice"
        nodes = Nodes()
        nodes.start("head", cpus=2)
        driver = program("--resume", out, "--address", nodes.address, "--json")
        found, said = driver.communicate(timeout=240)
        assert driver.returncode == 0, said
        assert f"{len(between)} are done already" in said
        assert json.loads(found)["done"] == 80
        after = done(out)
        assert all(after[case] == when for case, when in between.items()), "something was done twice"
        assert (out / "table.parquet").read_bytes() == whole
    finally:
        nodes.end()


def test_ctrl_c_stops_it_and_says_how_to_go_on(bench, nodes, tmp_path):
    path = campaign(bench, ROLLOUTS.format(seeds=20))
    out = tmp_path / "ray"
    driver = program(path, "--out", out, "--address", nodes.address)
    wait_for(2, out)
    driver.send_signal(signal.SIGINT)
    said = driver.communicate(timeout=120)[1]
    assert driver.returncode == 130, said
    assert "stopped on request; what is done is saved, go on with: python -m powderline.campaign --resume" in said.splitlines()[-1]
    assert (out / "table.parquet").exists() and 2 <= len(done(out)) < 80


def test_what_was_stopped_goes_on_in_the_same_process(bench, nodes, tmp_path, monkeypatch):
    loaded = Campaign.load(campaign(bench, ROLLOUTS.format(seeds=1)))

    def press(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as stopped:
        stopped.setattr("powderline.campaign.Session.have_done", press)
        with pytest.raises(KeyboardInterrupt, match="go on with") as kept:
            loaded.run(tmp_path / "ray", address=nodes.address, verbose=False)
    # Who keeps what was raised, as notebooks do, keeps nothing locked.
    result = loaded.run(tmp_path / "ray", resume=True, address=nodes.address, verbose=False)
    assert len(result.cases) == 4 and kept.tb is not None


def test_what_a_case_fails_of_is_said_and_stops_no_other(bench, nodes, tmp_path):
    # Its process is killed in the middle.
    path = campaign(bench, ROLLOUTS.format(seeds=10))
    out = tmp_path / "ray"
    driver = program(path, "--out", out, "--address", nodes.address, "--json")
    wait_for(2, out)
    killed = 0
    began = time.monotonic()
    while killed == 0:
        assert time.monotonic() - began < 60.0, "there is no worker to be killed"
        for entry in Path("/proc").iterdir():
            try:
                words = (entry / "cmdline").read_bytes().split(b"\0") if entry.name.isdigit() else []
            except OSError:
                continue
            if b"--worker" in words and any(b"powderline-campaign-" in word for word in words) and killed == 0:
                os.kill(int(entry.name), signal.SIGKILL)
                killed = 1
    found, said = driver.communicate(timeout=240)
    assert driver.returncode == 1, said
    counts = json.loads(found)
    assert (counts["failed"], counts["done"]) == (1, 39)
    assert said.splitlines()[-1].startswith("1 case failed; the first: its process was killed")
    result = Campaign.load(out).run(out, resume=True, address=nodes.address, verbose=False)
    assert result.exit_code == 0 and len(result.cases) == 40


def tries(folder):
    """What each search of a comparison tried, but for what a clock says."""
    found = {}
    for file in sorted(Path(folder).glob("*-seed*/tries.jsonl")):
        found[file.parent.name] = [{**json.loads(line), "cpu_seconds": 0.0} for line in file.read_text().splitlines()]
    return found


def test_the_searches_of_a_comparison_are_what_they_are_on_one_machine(bench, nodes, tmp_path, monkeypatch, capsys):
    which = {"methods": ["cma-es", "random"], "seeds": [1, 2], "rollouts": [10, 40]}
    words = [word for name, listed in which.items() for word in (f"--{name}", ",".join(map(str, listed)))]
    alone = [sys.executable, "-m", "powderline", "compare", bench / "tiny.toml", *words, "--out", tmp_path / "alone"]
    subprocess.run(alone, check=True, capture_output=True)
    whole = tries(tmp_path / "alone")
    assert len(whole) == 4
    # From task to task, whenever an epoch is saved.
    kept = []
    keep = cluster._Searches.kept
    monkeypatch.setattr(cluster, "SLICE_S", 0.1)
    monkeypatch.setattr(cluster._Searches, "kept", lambda self, what: (kept.append(what["index"]), keep(self, what)))
    found = cluster.compare(bench / "tiny.toml", tmp_path / "ray", **which, address=nodes.address)
    assert tries(tmp_path / "ray") == whole
    assert len(kept) >= 8 and set(kept) == {0, 1, 2, 3}
    said = capsys.readouterr().err
    assert "2 searches at a time" in said and "[4/4] " in said
    assert [row["method"] for row in found["rows"]] == which["methods"] and found["seeds"] == which["seeds"]
    assert (tmp_path / "ray" / "curves.svg").exists() and not list((tmp_path / "ray").glob("*.new"))
    # There is nothing left to do, and with more rollouts only that.
    again = cluster.compare(out=tmp_path / "ray", resume=True, address=nodes.address, verbose=False)
    assert again == found
    longer = cluster.compare(out=tmp_path / "ray", resume=True, rollouts=[10, 60], address=nodes.address, verbose=False)
    assert longer["rollouts"] == [10, 60]
    assert all(tried[: len(whole[name])] == whole[name] for name, tried in tries(tmp_path / "ray").items())


def test_a_comparison_that_was_stopped_goes_on(bench, nodes, tmp_path):
    which = ["--methods", "random", "--seeds", "1,2,3", "--rollouts", "200"]
    out = tmp_path / "ray"
    driver = program("--address", nodes.address, "compare", bench / "tiny.toml", *which, "--out", out, module="cluster")
    began = time.monotonic()
    while not (out / "comparison.json").exists():
        assert time.monotonic() - began < 120.0
        time.sleep(0.05)
    time.sleep(5.0)
    driver.send_signal(signal.SIGINT)
    said = driver.communicate(timeout=120)[1]
    assert driver.returncode == 130, said
    assert f"go on with: python -m powderline.cluster --address {nodes.address} compare --resume {out}" in said.splitlines()[-1]
    driver = program("--address", nodes.address, "--json", "compare", "--resume", out, module="cluster")
    found, said = driver.communicate(timeout=240)
    assert driver.returncode == 0, said
    assert json.loads(found)["rows"][0]["method"] == "random"
    assert min(len(tried) for tried in tries(out).values()) >= 200


def test_a_driver_that_was_killed_while_it_replaced_a_search_has_lost_nothing(tmp_path):
    searches = cluster._Searches(tmp_path, ["random-seed1"], None)
    searches.kept({"index": 0, "files": [("state", b"first"), ("stdout", b"{}")]})
    searches.kept({"index": 0, "files": [("state", b"second")]})
    assert [path.name for path in tmp_path.iterdir()] == ["random-seed1"]
    (tmp_path / "random-seed1").rename(tmp_path / "random-seed1.old")
    assert searches.begun() == {0: [("state", b"second")]}


def test_tables_of_scenes_come_from_a_cluster(bench, nodes, tmp_path):
    with pytest.raises(ValueError, match="nothing.toml"):
        cluster.validate([bench / "tiny.toml", bench / "nothing.toml"], address=nodes.address)
    with pytest.raises(ValueError, match="give each once"):
        cluster.validate(["bench", "bench"], address=nodes.address)
    name = str(bench / "tiny.toml")
    tables = cluster.validate([name], write=tmp_path / "tables", address=nodes.address, verbose=False)
    assert tables[name]["scene"] == "tiny" and tables[name]["summary"].startswith("Of ")
    assert json.loads((tmp_path / "tables" / "tiny.json").read_text()) == tables[name]


def test_what_makes_no_sense_is_refused_before_anything_is_begun(bench, nodes, tmp_path):
    wrong = campaign(bench, ROLLOUTS.format(seeds=2).replace("1500.0", "-1.0"), "wrong")
    with pytest.raises(ValueError, match=r"(?s)2 of 4 cases cannot be run, each with 2 seeds, .*tiny_heavy_0.8g: powder.density"):
        Campaign.load(wrong).check()
    right = Campaign.load(campaign(bench, ROLLOUTS.format(seeds=2)))
    out = tmp_path / "never"
    for wrong, sentence in [
        ({"memory": "1MiB"}, "memory"),
        ({"threads": 0}, "threads is 0, but it must be from 1"),
        ({"memory": "lots"}, "lots"),
        ({"out": "nowhere://there"}, "nowhere"),
        ({"out": bench / "tiny.toml"}, "which is a file"),
        ({"resume": True}, "holds nothing to resume"),
    ]:
        with pytest.raises(ValueError, match=sentence):
            right.run(**{"out": out, "address": nodes.address, "verbose": False, **wrong})
    assert not out.exists()
    with pytest.raises(ValueError, match="that rise would be right"):
        cluster.compare(bench / "tiny.toml", out, rollouts=[3, 2], address=nodes.address)
    with pytest.raises(ValueError, match="holds nothing to resume"):
        cluster.compare(out=out, resume=True, address=nodes.address)
    with pytest.raises(ClusterError, match="for a search; the largest has 1 CPU"):
        cluster.compare(bench / "tiny.toml", tmp_path / "large", methods=["random"], threads=64, address=nodes.address, verbose=False)
    with pytest.raises(ClusterError, match="no node of the cluster has 64 CPUs and .* the largest has 1 CPU and 4096 MiB"):
        right.run(out, address=nodes.address, threads=64, verbose=False)
    with pytest.raises(ClusterError, match="at 127.0.0.1:1 there is no Ray cluster"):
        right.run(tmp_path / "nowhere", address="127.0.0.1:1", verbose=False)


def test_without_ray_it_says_how_to_get_it(bench, tmp_path, monkeypatch):
    path = campaign(bench, ROLLOUTS.format(seeds=1))
    unused = "import sys, powderline.campaign as c; c.Campaign.load(sys.argv[1]).check(); sys.exit('ray' in sys.modules)"
    subprocess.run([sys.executable, "-c", unused, path], check=True)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r"powderline\[campaign\].*optimise campaign FILE"):
        Campaign.load(path).run(tmp_path / "never", verbose=False)
    with pytest.raises(ImportError, match=r"powderline\[campaign\].*optimise compare"):
        cluster.compare(bench / "tiny.toml", tmp_path / "never")
    assert not (tmp_path / "never").exists()
