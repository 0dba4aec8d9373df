function octave_commands()
%OCTAVE_COMMANDS  Every command moves the device, or sets what it should.

    features = {'servo_jp', 'servo_jr', 'servo_jv', 'servo_jf', 'servo_js', 'servo_cp', ...
        'servo_cr', 'servo_cv', 'servo_cf', 'servo_cs', 'interpolate_jf', 'interpolate_cf', ...
        'interpolate_jp', 'interpolate_jr', 'interpolate_jv', ...
        'interpolate_cp', 'interpolate_cr', 'interpolate_cv', 'move_jp', 'move_jr', 'move_cp', ...
        'move_cr', 'hold', 'free', 'measured_js', 'setpoint_js', 'forward_kinematics', ...
        'inverse_kinematics'};
    ral = crtk.ral('octave_commands');
    r = device_under_test(getenv('CRTK_NAMESPACE'), ral, features);
    r.crtk_utils.add('body/servo_cv');
    r.enable(60.0);
    zero = zeros(4, 1);

    % moves, with a handle
    goal = [0.8; 0.2; 0.3; 0.4];
    handle = r.move_jp(goal');
    check(isa(handle, 'crtk.wait_move_handle'), 'a move returns a %s', class(handle));
    check(handle.wait(true), 'the move did not begin');
    check(handle.is_busy(), 'the move is not busy');
    check(~handle.wait(false, 0.01), 'the move ended at once');
    check(handle.wait(), 'the move did not end');
    check(~handle.is_busy(), 'the move is still busy');
    ends_at(r, goal, 1e-6, 'move_jp');
    check(r.move_jr([0.1 0 0 0]).wait(false, 60.0), 'move_jr did not end');
    ends_at(r, goal + [0.1; 0; 0; 0], 1e-6, 'move_jr');
    check(r.move_cp(r.forward_kinematics(zero)).wait(false, 60.0), 'move_cp did not end');
    ends_at(r, zero, 1e-3, 'move_cp');
    lift = eye(4);
    lift(3, 4) = 0.1;
    check(r.move_cr(lift).wait(false, 60.0), 'move_cr did not end');
    ends_at(r, [0; 0; 0.1; 0], 1e-3, 'move_cr');

    % streams of positions and increments; rows and columns alike
    small = 1e-3 * [1; 2; 3; 4];
    start = r.setpoint_jp();
    for k = 1:20, r.servo_jp(start + k * small); pause(0.01); end
    arrives(r, start + 20 * small, 'servo_jp');
    start = r.setpoint_jp();
    r.servo_jp(start + small, zero);
    arrives(r, start + small, 'servo_jp with a velocity');
    start = r.setpoint_jp();
    for k = 1:5, r.servo_jr(small'); pause(0.01); end
    arrives(r, start + 5 * small, 'servo_jr');
    start = r.setpoint_jp();
    r.servo_js([1 1 1 1], start + small, [], []);
    arrives(r, start + small, 'servo_js');
    r.servo_cp(r.forward_kinematics(start));
    arrives(r, start, 'servo_cp');
    lift(3, 4) = 0.002;
    r.servo_cr(lift);
    arrives(r, start + [0; 0; 0.002; 0], 'servo_cr');

    % velocities and efforts
    moves_up(r, @() r.servo_jv([0 0 0.05 0]), 'servo_jv');
    moves_up(r, @() r.servo_jf([0 0 2 0]), 'servo_jf');
    moves_up(r, @() r.servo_cv([0 0 0.05 0 0 0]), 'servo_cv');
    moves_up(r, @() r.body_servo_cv([0 0 0.05 0 0 0]), 'body/servo_cv');
    moves_up(r, @() r.servo_cf([0 0 2 0 0 0]), 'servo_cf');
    moves_up(r, @() r.servo_js([1 1 2 1], r.setpoint_jp(), [0 0 0.05 0]), 'servo_js, mixed');
    moves_up(r, @() r.servo_cs([2 2 2 2 2 2], eye(4), [0 0 0.05 0 0 0], zeros(1, 6), eye(4)), ...
        'servo_cs');
    moves_up(r, @() r.interpolate_jf([0 0 2 0]), 'interpolate_jf');
    moves_up(r, @() r.interpolate_cf([0 0 2 0 0 0]), 'interpolate_cf');
    moves_up(r, @() r.interpolate_jv([0 0 0.05 0]), 'interpolate_jv');
    moves_up(r, @() r.interpolate_cv([0; 0; 0.05; 0; 0; 0]), 'interpolate_cv');
    moves_up(r, @() r.interpolate_jr([0 0 0.002 0]), 'interpolate_jr');
    moves_up(r, @() r.interpolate_cr(lift), 'interpolate_cr');
    goal = r.setpoint_jp() + small;
    r.interpolate_jp(goal);
    arrives(r, goal, 'interpolate_jp');
    goal = r.setpoint_jp() + small;
    r.interpolate_cp(r.forward_kinematics(goal));
    arrives(r, goal, 'interpolate_cp');
    r.free();
    r.hold();

    % kinematics
    cp = r.forward_kinematics([0.1 0.2 0.3 0.4]);
    check_near(cp(1:3, 4), [0.1; 0.2; 0.3], 1e-12, 'forward_kinematics');
    check_near(r.inverse_kinematics(cp), [0.1; 0.2; 0.3; 0.4], 1e-12, 'inverse_kinematics');
    check_near(r.inverse_kinematics(cp, zero'), [0.1; 0.2; 0.3; 0.4], 1e-12, 'with a reference');
    ral.shutdown();
end

function ends_at(r, goal, tolerance, name)
%ENDS_AT  Hear that a move has ended at its goal: the newest setpoint heard may be a publication older.
    check_until(@() all(abs(r.setpoint_jp() - goal) <= tolerance), sprintf('%s ends at its goal', name));
end

function arrives(r, goal, name)
%ARRIVES  Wait until it is there, and end the stream: another may not take over from one that runs.
    check_until(@() norm(r.measured_jp() - goal) < 2e-4, sprintf('%s has arrived', name));
    r.hold();
end

function moves_up(r, send, name)
%MOVES_UP  Send until z has risen by 5 mm, and nothing else has moved.
    start = r.measured_jp();
    begin = tic;
    moved = zeros(4, 1);
    while moved(3) < 0.005
        check(toc(begin) < 60.0, '%s: it moved by %s', name, mat2str(moved', 3));
        send();
        pause(0.01);
        moved = r.measured_jp() - start;
    end
    r.hold();
    check(max(abs(moved([1, 2, 4]))) < 1e-3, '%s: it moved by %s', name, mat2str(moved', 3));
end
