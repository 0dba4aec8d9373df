function octave_errors()
%OCTAVE_ERRORS  What the client raises arrives with its identifier and its remedy.

    namespace = getenv('CRTK_NAMESPACE');
    check_raises('crtk:Config', 'no name of a ROS node', @() crtk.ral('no name'));
    ral = crtk.ral('octave_errors');
    r = device_under_test(namespace, ral, {'measured_js', 'setpoint_js', 'servo_jp', 'servo_cp', ...
        'servo_cv', 'move_jp', 'move_cp', 'hold', 'inverse_kinematics', 'trajectory_j_set_ratio'});

    % what is not offered
    check_raises('crtk:NotOffered', 'does not offer use_gravity_compensation. It offers: .*measured_js', ...
        @() r.crtk_utils.add_use_gravity_compensation());
    check_raises('crtk:NotOffered', 'no CRTK command serve_jp', @() r.crtk_utils.add('serve_jp'));
    check_raises('crtk:Exists', 'measured_js already exists', @() r.crtk_utils.add_measured_js());
    ral.connect_timeout = 0.5;
    check_raises('crtk:ConnectionFailed', '/nobody', ...
        @() device_under_test('nobody', ral, {}));

    % refused by the device
    check_raises('crtk:Refused', 'not_enabled', @() r.move_jp(zeros(1, 4)));
    check_raises('crtk:Refused', 'invalid_transition', @() r.resume());
    r.enable(60.0);
    check_raises('crtk:Refused', 'out_of_range.*outside.*Stay within', @() r.move_jp([9 0 0 0]));
    check_raises('crtk:Refused', 'wrong_size', @() r.move_jp([0 0 0]));
    check_raises('crtk:Refused', 'not_finite', @() r.move_jp([NaN 0 0 0]));
    check_raises('crtk:Refused', 'servo_jp.*wrong_size', @() stream(@() r.servo_jp(0)));
    check_raises('crtk:Refused', 'not_finite', @() stream(@() r.servo_jp([Inf 0 0 0])));

    % refused before anything is sent
    check_raises('crtk:Refused', 'Pass one number for each joint', @() r.move_jp(zeros(2, 2)));
    check_raises('crtk:Refused', '2 arguments.*4x4', @() r.move_cp(eye(4), 1));
    check_raises('crtk:Refused', '0 arguments', @() r.move_jp());
    check_raises('crtk:Refused', 'Pass nothing', @() r.hold(1));
    check_raises('crtk:Refused', '4x4', @() r.move_cp(eye(3)));
    check_raises('crtk:Refused', 'no rotation', @() r.servo_cp(zeros(4)));
    check_raises('crtk:Refused', 'no rotation', @() r.servo_cp(2 * eye(4)));
    check_raises('crtk:Refused', 'no rotation', @() r.servo_cp(diag([1 1 -1 1])));
    check_raises('crtk:Refused', 'last row', @() r.servo_cp([eye(3), [0; 0; 0]; 1 1 1 1]));
    check_raises('crtk:Refused', '6 numbers', @() r.servo_cv(zeros(1, 5)));
    check_raises('crtk:Refused', 'Pass a number', @() r.trajectory_j_set_ratio([1 1]));
    check_raises('crtk:Input', 'move_jp: pass .* not a cell', @() r.move_jp({0, 0, 0, 0}));
    check_raises('crtk:Input', 'real numbers', @() r.move_jp([1i 0 0 0]));
    check_raises('crtk:Input', 'not a double of size \[1 4 2\]', @() r.move_jp(zeros(1, 4, 2)));
    check_raises('crtk:Kinematics', 'turns about z only', ...
        @() r.inverse_kinematics(diag([1 -1 -1 1])));

    % a move that ends elsewhere
    r.trajectory_j_set_ratio(0.02);
    handle = r.move_jp([0.9 0 0 0]);
    r.hold();
    check_raises('crtk:MotionAborted', 'move_jp', @() handle.wait(false, 60.0));

    % a device that says nothing any more
    pid = getenv('CRTK_DRIVER_PID');
    check(system(['kill -STOP ' pid]) == 0, 'the driver could not be stopped');
    resume = onCleanup(@() system(['kill -CONT ' pid]));
    pause(0.5);
    check_raises('crtk:Timeout', 'measured_js.*age=0', @() r.measured_js('age', 0.1, 'wait', 0.1));
    check_raises('crtk:ConnectionLost', 'has been silent', @() r.disable(0.5));
    check(numel(r.measured_jp('age', 0)) == 4, 'the last value is gone');
    clear resume
    check_until(@() r.measured_js('age', 0.1, 'wait', 60.0)(1) < 2, 'it is back');

    % after the end
    ral.shutdown();
    check_raises('crtk:Config', 'was closed', @() r.measured_js());
    check_raises('crtk:Config', 'shut down', @() ral.check_connections());
end

function stream(send)
%STREAM  The refusal of a stream is raised by a later call.
    for k = 1:200
        send();
        pause(0.01);
    end
end
