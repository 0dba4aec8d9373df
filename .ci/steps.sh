# What the scripts of this folder are made of: steps with a limit, and what runs beside them.
# shellcheck shell=bash

budget=4500 # seconds for the whole run; on two quiet cores it takes about a sixth of that
patience=${patience:-1} # how many times as long as on a machine of its own a step may take
passed=0
failed=0

fail() {
  printf '\nFAILED: %s\n%s passed, %s failed\n' "$1" "$passed" "$failed"
  exit 1
}

# step NAME SECONDS COMMAND...: run COMMAND, which may take SECONDS. SIGABRT makes a test run that
# hangs print the stack of every thread.
step() {
  local name=$1 limit=$(($2 * patience)) begin=$SECONDS code=0 log
  shift 2
  log=$(mktemp -p "$work")
  if ((limit > budget - begin)); then limit=$((budget - begin)); fi
  if ((limit <= 0)); then fail "$name: the $budget s for the whole run are over"; fi
  printf '\n=== %s\n' "$name"
  timeout --signal=ABRT --kill-after=10 "$limit" "$@" </dev/null 2>&1 | tee "$log" || code=${PIPESTATUS[0]}
  printf '=== %s: %s s\n' "$name" $((SECONDS - begin))
  count_tests "$log"
  case $code in
    0) ;;
    124 | 134 | 137) fail "$name: stopped after $limit s" ;;
    *) fail "$name: exit code $code" ;;
  esac
}

# count_tests LOG: add pytest's summary line, when the step had one, to the totals.
count_tests() {
  local summary
  summary=$(tail -n 1 "$1" | grep -E '(passed|failed|errors?|skipped).* in [0-9.]+s' || true)
  passed=$((passed + $(grep -oE '[0-9]+ passed' <<<"$summary" | cut -d' ' -f1 || echo 0)))
  failed=$((failed + $(grep -oE '[0-9]+ (failed|error)' <<<"$summary" | cut -d' ' -f1 | paste -sd+ || echo 0)))
}

# beside SCRIPT: run a script of this folder beside what follows, with what others leave of the processor, which
# may be a twentieth of it: its steps are given time until what it runs beside has long ended.
# It has a session of its own: Linux may give all processes of one the share of one (sched_autogroup).
beside() {
  patience=10 setsid bash -c '
    echo 19 2>/dev/null >/proc/self/autogroup || true
    renice --priority 19 --pid $$ >/dev/null
    chrt --idle --pid 0 $$ || true
    exec bash "$1"' _ ".ci/$1" >"$work/$1.log" 2>&1 </dev/null &
  jobs_beside[$1]=$!
}
declare -A jobs_beside=()

# await SCRIPT: wait for what runs beside, print what it wrote, and fail if it did.
await() {
  local code=0
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
