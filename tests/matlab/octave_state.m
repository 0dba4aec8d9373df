function octave_state()
%OCTAVE_STATE  The operating state, events, the layer, and a device below another.

    ral = crtk.ral('octave_state');
    check(strcmp(ral.name, 'octave_state'), 'name %s', ral.name);
    namespace = ['/' getenv('CRTK_NAMESPACE') '/'];
    r = device_under_test(namespace, ral, {'move_jp', 'setpoint_js'});
    ral.check_connections(60.0);
    ral.spin();

    state = r.operating_state();
    check(isequal(state, struct('state', 'DISABLED', 'is_homed', false, 'is_busy', false)), ...
        'the state is %s', jsonencode(state));
    check(~r.is_enabled() && ~r.is_homed() && ~r.is_busy(), 'before enable');
    check(r.enable(60.0), 'enable');
    check(r.is_enabled(), 'it is not enabled');
    check(r.home(), 'home');
    check(r.is_homed(), 'it is not homed');
    check(r.unhome(60.0) && ~r.is_homed(), 'it is homed');
    check(r.home(60.0) && r.pause(60.0), 'pause');
    check(strcmp(r.operating_state().state, 'PAUSED'), 'it is not paused');
    check(r.wait_for_operating_state('PAUSED', 1.0), 'it is not paused');
    check(~r.wait_for_operating_state('ENABLED', 0.2), 'it is not paused');
    check(r.resume(Inf), 'resume');
    check(r.operating_state_command('disable'), 'operating_state_command');
    check(r.state_command('enable', 60.0), 'state_command');

    % events
    r.events();
    check(isempty(r.events()), 'there are events left');
    goal = r.setpoint_jp() + 0.1;
    handle = r.move_jp(goal);
    check(r.wait_for_busy(true, 60.0), 'it was never busy');
    check(handle.wait(false, 60.0) && r.wait_for_busy(false, 60.0), 'it is busy');
    check_raises('crtk:Refused', 'out_of_range', @() r.move_jp([9 9 9 9]));
    events = r.events(1.0);
    kinds = {events.kind};
    busy = events(strcmp(kinds, 'status') & [events.is_busy]);
    check(~isempty(busy) && strcmp(busy(1).state, 'ENABLED'), 'no busy: %s', jsonencode(events));
    refusals = events(strcmp(kinds, 'refusal'));
    check(numel(refusals) == 1 && strcmp(refusals.command, 'move_jp') ...
        && strcmp(refusals.reason, 'out_of_range'), 'refusals: %s', jsonencode(refusals));
    check(issorted([events.time]), 'events out of order');

    % a device below another has its operating state
    part = struct('under', device_below([namespace 'local'], ral, r));
    check(part.under.operating_state().is_homed, 'the part has another state');
    check_near(part.under.measured_cp(), eye(4), 2.0, 'the part');
    check_raises('crtk:Input', 'add_operating_state first', ...
        @() device_below([namespace 'local'], ral, dynamicprops()));
    check_raises('crtk:Config', 'is not below', @() device_below('elsewhere', ral, r));

    % a loop at a rate
    rate = ral.rate(100);
    reset(rate);
    start = tic;
    for k = 1:20
        waitfor(rate);
    end
    check(toc(start) >= 0.199, '20 periods of 10 ms took %g s', toc(start));
    pause(0.05);
    waitfor(rate);
    start = tic;
    for k = 1:5
        waitfor(rate);
    end
    check(toc(start) >= 0.049, 'what was late was made up for: 5 periods took %g s', toc(start));

    % the end
    check(~ral.is_shutdown(), 'it is shut down');
    ral.spin_and_execute(@(x) check(x == 1, 'not called with 1'), 1);
    check(ral.is_shutdown(), 'it is not shut down');
    ral.shutdown();

    % without a layer of one's own
    r = device_below(namespace);
    check_near(r.measured_cp(), eye(4), 2.0, 'without a ral');
end
