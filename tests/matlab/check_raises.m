function check_raises(identifier, pattern, f)
%CHECK_RAISES  Raise an error unless f raises one with this identifier and a message that matches.

    try
        f();
    catch raised
        check(strcmp(raised.identifier, identifier), '%s where it should be %s: %s', ...
            raised.identifier, identifier, raised.message);
        check(~isempty(regexp(raised.message, pattern, 'once')), '%s: "%s" should match "%s"', ...
            identifier, raised.message, pattern);
        return
    end
    error('check:failed', 'nothing was raised where it should be %s', identifier);
end
