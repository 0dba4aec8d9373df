function check(condition, varargin)
%CHECK  Raise an error with the text that follows, unless all of condition holds.

    if ~all(condition(:)) || isempty(condition)
        error('check:failed', varargin{:});
    end
end
