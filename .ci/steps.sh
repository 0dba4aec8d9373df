# What the scripts of this folder are made of: steps with a limit, and what runs beside them.
# shellcheck shell=bash

budget=4500 # seconds for the whole run; on two quiet cores it takes about a sixth of that
patience=${patience:-1} # how many times as long as on a machine of its own a step may take
passed=0
failed=0
unsteady=0
unsteady_tests=$work/unsteady # a file with three lines for each unsteady test

fail() {
  printf '\nFAILED: %s\n' "$1"
  totals
  exit 1
}

# totals: print how many tests passed, failed and were unsteady, and name the unsteady ones.
totals() {
  printf '%s passed, %s failed, %s unsteady\n' "$passed" "$failed" "$unsteady"
  if [[ -s $unsteady_tests ]]; then cat "$unsteady_tests"; fi
}

# attempt NAME SECONDS COMMAND...: run COMMAND, which may take SECONDS. Its exit code is in `code`, its output in the
# file `log`. SIGABRT makes a test run that hangs print the stack of every thread.
attempt() {
  local name=$1 begin=$SECONDS
  limit=$(($2 * patience)) code=0 log=$(mktemp -p "$work")
  shift 2
  if ((limit > budget - begin)); then limit=$((budget - begin)); fi
  if ((limit <= 0)); then fail "$name: the $budget s for the whole run are over"; fi
  printf '\n=== %s\n' "$name"
  timeout --signal=ABRT --kill-after=10 "$limit" "$@" </dev/null 2>&1 | tee "$log" || code=${PIPESTATUS[0]}
  printf '=== %s: %s s\n' "$name" $((SECONDS - begin))
  count_tests "$log"
}

# judge NAME: end the run if the last attempt failed.
judge() {
  case $code in
    0) ;;
    124 | 134 | 137) fail "$1: stopped after $limit s" ;;
    *) fail "$1: exit code $code" ;;
  esac
}

# step NAME SECONDS COMMAND...: run COMMAND, and end the run if it fails.
step() {
  attempt "$@"
  judge "$1"
}

# What uv and pip print where a download fails. Of an index that does not answer, pip says that it has no such version.
download_failed='Request failed after|Failed to (fetch|download|read from zip)|Max retries exceeded|Read timed out|No matching distribution found|Wheel .* is invalid'
pause=${pause:-10} # seconds before the next try

# download NAME SECONDS COMMAND...: as step, for a COMMAND that downloads. An index that does not answer says nothing
# about this repository, so there are three tries; whatever else fails ends the run at once.
download() {
  local try
  for try in 1 2 3; do
    attempt "$@"
    if ((code == 0 || try == 3)) || ! grep -qE "$download_failed" "$log"; then break; fi
    printf '=== %s: a download failed; try %s of 3 begins in %s s\n' "$1" $((try + 1)) "$pause"
    sleep "$pause"
  done
  judge "$1"
}

# count_tests LOG: add pytest's summary line, when the step had one, to the totals.
count_tests() {
  local summary
  summary=$(tail -n 1 "$1" | grep -E '(passed|failed|errors?|skipped).* in [0-9.]+s' || true)
  passed=$((passed + $(grep -oE '[0-9]+ passed' <<<"$summary" | cut -d' ' -f1 || echo 0)))
  failed=$((failed + $(grep -oE '[0-9]+ (failed|error)' <<<"$summary" | cut -d' ' -f1 | paste -sd+ || echo 0)))
}

# interpreter_of VERSION: print where a Python is: pyenv's, of which uv sees only the chosen one, or what uv finds or
# fetches.
interpreter_of() {
  local own
  for own in "${PYENV_ROOT:-$HOME/.pyenv}"/versions/"$1".*/bin/python3; do
    if [[ -x $own ]]; then
      printf '%s\n' "$own"
      return
    fi
  done
  timeout 30 "$uv" python install --quiet "$1" >"$work/fetched" 2>&1 || true
  "$uv" python find "$1" 2>>"$work/fetched"
}

# again FILE: run alone, three times, each test that failed, and end the run unless all pass. `pytest --failures`
# wrote FILE.
again() {
  attempt "What failed, again and alone" 1800 "$uv" run --group test python .ci/again.py "$1" "$unsteady_tests"
  unsteady=$(grep -c '^unsteady' "$unsteady_tests" || true)
  failed=$((failed - unsteady))
  if ((code == 1)); then fail "Tests: $(tail -n 1 "$log")"; fi
  judge "What failed, again and alone"
  failed=0 # a test may have been counted twice: it failed, and so did its teardown
}

# beside SCRIPT: run a script of this folder beside what follows, in a session of its own.
beside() {
  setsid bash ".ci/$1" >"$work/$1.log" 2>&1 </dev/null &
  jobs_beside[$1]=$!
}
declare -A jobs_beside=()

# idle_beside SCRIPT: as beside, with the time that others leave of the processor. That may be a twentieth of it, so its
# steps are given ten times their time. Linux may give all processes of a session the share of one (sched_autogroup).
idle_beside() {
  patience=10 setsid bash -c '
    echo 19 2>/dev/null >/proc/self/autogroup || true
    renice --priority 19 --pid $$ >/dev/null
    chrt --idle --pid 0 $$ || true
    exec bash "$1"' _ ".ci/$1" >"$work/$1.log" 2>&1 </dev/null &
  jobs_beside[$1]=$!
}

# await SCRIPT: wait for what runs beside, print what it wrote, and fail if it did.
await() {
  local code=0
  python3 .ci/hurry.py "${jobs_beside[$1]}" # it may have had no time at all while others computed
  wait "${jobs_beside[$1]}" || code=$?
  unset "jobs_beside[$1]"
  cat "$work/$1.log"
  if ((code)); then fail ".ci/$1"; fi
}

# end_beside: end what still runs beside.
end_beside() {
  local job
  for job in "${jobs_beside[@]}"; do kill -TERM -- "-$job" 2>/dev/null || true; done
  wait
}
